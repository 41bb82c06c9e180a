-- Number of questions in each template, by requested value and answer mode.
SELECT family, template, asks, answer_mode AS mode, count(*) AS n, n / sum(count(*)) OVER () AS share
FROM measured
GROUP BY ALL
ORDER BY ALL;
