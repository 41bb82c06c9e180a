-- Number of questions in each family and template, and number of sequences with such questions.
SELECT family, template, count(*) AS questions, count(DISTINCT sequence) AS sequences
FROM questions
GROUP BY family, template
ORDER BY family, template;
