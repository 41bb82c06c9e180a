-- Agreement of each pair of reviewers on the questions that both decided. Cohen's kappa is the agreement beyond chance.
-- It is null if both reviewers gave one and the same decision to all questions.
WITH pairs AS (
    SELECT a.reviewer AS first, b.reviewer AS second, count(*) AS n, count_if(a.decision = b.decision) AS agree,
           (count_if(a.decision = 'accept') * count_if(b.decision = 'accept')
            + count_if(a.decision = 'reject') * count_if(b.decision = 'reject'))::BIGINT / n ** 2 AS chance
    FROM reviews a
    JOIN reviews b ON a.question_id = b.question_id AND a.reviewer < b.reviewer
    GROUP BY a.reviewer, b.reviewer
)
SELECT first, second, n, agree::BIGINT AS agree, (agree / n - chance) / nullif(1 - chance, 0) AS kappa
FROM pairs
ORDER BY first, second;
