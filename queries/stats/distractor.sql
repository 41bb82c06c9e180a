-- Wrong choices of each template by the change of the plan that gives them. A wrong choice that no change gives is
-- counted as "none", and is false by other facts. Names are cut at " without ", so that all look-alikes count as one.
WITH wrong AS (SELECT template, unnest(wrong) AS name FROM measured)
SELECT template, split_part(coalesce(name, 'none'), ' without ', 1) AS yielded_by, count(*) AS n,
       n / sum(count(*)) OVER (PARTITION BY template) AS share
FROM wrong
GROUP BY template, yielded_by
ORDER BY ALL;
