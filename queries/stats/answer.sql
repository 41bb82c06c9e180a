-- Answers of each template by kind of answer: texts of choices by name, bins of times in their order.
SELECT template, asks, answer, count(*) AS n, n / sum(count(*)) OVER (PARTITION BY template, asks) AS share
FROM measured
GROUP BY template, asks, answer
ORDER BY template, asks, coalesce(TRY_CAST(regexp_extract(answer, '^\[?([0-9.]+)', 1) AS DOUBLE), 0), answer;
