-- Frequency of each answer in each template. Choices are in alphabetical order, and bins of times in order of time.
SELECT template, asks, answer, count(*) AS n, n / sum(count(*)) OVER (PARTITION BY template, asks) AS share
FROM measured
GROUP BY template, asks, answer
ORDER BY template, asks, coalesce(TRY_CAST(regexp_extract(answer, '^\[?([0-9.]+)', 1) AS DOUBLE), 0), answer;
