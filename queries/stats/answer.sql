-- Number of questions with each answer, and with the answer among the choices. Bins of times are in order of time.
SELECT template, asks, answer, sum(n)::BIGINT AS n, sum(offered)::BIGINT AS offered,
       sum(n) / sum(sum(n)) OVER (PARTITION BY template, asks) AS share
FROM (SELECT template, asks, answer, 1 AS n, NULL AS offered FROM measured
      UNION ALL SELECT template, asks, unnest(choices), 0, 1 FROM measured)
GROUP BY template, asks, answer
ORDER BY template, asks, coalesce(TRY_CAST(regexp_extract(answer, '^\[?([0-9.]+)', 1) AS DOUBLE), 0), answer;
