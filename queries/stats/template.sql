-- Number of questions in each template, by requested value and answer mode, with their people and sequences.
SELECT family, template, asks, answer_mode AS mode, count(*) AS n, n / sum(count(*)) OVER () AS share,
       count(DISTINCT (sequence, target_track)) AS people, count(DISTINCT sequence) AS sequences
FROM measured
GROUP BY ALL
ORDER BY ALL;
