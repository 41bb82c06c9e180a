-- Wrong choices by the perturbation that yields them; "none" are answers known to be false that no perturbation yields.
-- "look-alike without action sitting" and similar names count as one.
WITH wrong AS (SELECT template, unnest(wrong) AS name FROM measured)
SELECT template, split_part(coalesce(name, 'none'), ' without ', 1) AS yielded_by, count(*) AS n,
       n / sum(count(*)) OVER (PARTITION BY template) AS share
FROM wrong
GROUP BY template, yielded_by
ORDER BY ALL;
