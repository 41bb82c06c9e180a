-- How often the true choice is at each position of the list, in each template.
SELECT template, position, count(*) AS n, n / sum(count(*)) OVER (PARTITION BY template) AS share
FROM measured
WHERE position IS NOT NULL
GROUP BY template, position
ORDER BY ALL;
