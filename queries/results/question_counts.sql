-- Questions per family and template, over how many sequences.
SELECT family, template, count(*) AS questions, count(DISTINCT sequence) AS sequences
FROM questions
GROUP BY family, template
ORDER BY family, template;
