-- Minimum, median, mean and maximum of each measure over the questions of each template.
SELECT template, what, count(*) AS n, min(amount) AS min,
       (list_sort(list(amount))[(n + 1) // 2] + list_sort(list(amount))[n // 2 + 1]) / 2 AS median,
       sum(amount) / n AS mean, max(amount) AS max
FROM (UNPIVOT measured ON time_gap_s, separation_deg, apart_deg, hops, words, people_in_scene, crops
      INTO NAME what VALUE amount)
GROUP BY template, what
ORDER BY template, list_position(
    ['time_gap_s', 'separation_deg', 'apart_deg', 'hops', 'words', 'people_in_scene', 'crops'], what);
