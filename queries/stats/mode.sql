-- Number of questions with each answer mode.
SELECT answer_mode AS mode, count(*) AS n, n / sum(count(*)) OVER () AS share
FROM measured
GROUP BY ALL
ORDER BY ALL;
