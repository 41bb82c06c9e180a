-- Number of questions, and of sequences with such questions, per family and template.
SELECT family, template, count(*) AS questions, count(DISTINCT sequence) AS sequences
FROM questions
GROUP BY family, template
ORDER BY family, template;
