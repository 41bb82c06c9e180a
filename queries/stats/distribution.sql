-- Number of questions in each bin of each measure, including empty bins.
-- A bin of counts is written "3" or "6-7", another bin "[20, 40)", and the last bin of a measure "12+".
WITH edges (place, what, lows) AS (
    VALUES (1, 'time_gap_s', [0, 0.001, 5, 10, 20, 40, 80]),
           (2, 'separation_deg', [0, 10, 20, 45, 90, 135]),
           (3, 'apart_deg', [0, 10, 20, 45, 90, 135]),
           (4, 'hops', [0, 1, 2, 3]),
           (5, 'words', [0, 30, 40, 50, 60, 80, 100, 120]),
           (6, 'people_in_scene', [0, 10, 20, 30, 40, 60, 80]),
           (7, 'crops', [0, 1, 2, 3, 4, 5, 6, 8, 12])
), bins AS (
    SELECT place, what, low, lead(low) OVER (PARTITION BY what ORDER BY low) AS high, low::INT AS l, high::INT AS h,
           CASE WHEN high IS NULL THEN l || '+'
                WHEN what = 'time_gap_s' AND h = 0 THEN '0'
                WHEN what = 'time_gap_s' AND l = 0 THEN '(0, ' || h || ')'
                WHEN place < 4 THEN '[' || l || ', ' || h || ')'
                WHEN h = l + 1 THEN l::TEXT
                ELSE l || '-' || (h - 1) END AS bin
    FROM (SELECT place, what, unnest(lows)::DOUBLE AS low FROM edges)
), measures AS (
    FROM (UNPIVOT measured ON time_gap_s, separation_deg, apart_deg, hops, words, people_in_scene, crops
          INTO NAME what VALUE amount)
)
SELECT bins.what, bin, count(amount) AS n, n / greatest((SELECT count(*) FROM measured), 1) AS share
FROM bins
LEFT JOIN measures ON measures.what = bins.what AND amount >= low AND (high IS NULL OR amount < high)
GROUP BY place, bins.what, low, bin
ORDER BY place, low;
