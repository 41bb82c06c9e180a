-- Number of questions per family and template, and of their sequences.
SELECT family, template, count(*) AS questions, count(DISTINCT sequence) AS sequences
FROM questions
GROUP BY family, template
ORDER BY family, template;
