-- Positions of the true choice.
SELECT template, position, count(*) AS n, n / sum(count(*)) OVER (PARTITION BY template) AS share
FROM measured
WHERE position IS NOT NULL
GROUP BY template, position
ORDER BY ALL;
