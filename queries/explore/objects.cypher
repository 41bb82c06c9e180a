// Number of things of each category, how many are certainly handled, and how many have only labels marked as hard.
MATCH (o:Object)
WHERE o.sequence = $sequence
OPTIONAL MATCH (:Person)-[r:Handles]->(o)
WITH o, max(CASE r.certain WHEN true THEN 2 WHEN false THEN 1 ELSE 0 END) AS told
RETURN o.category AS category, count(*) AS things,
       CAST(sum(CASE told WHEN 2 THEN 1 ELSE 0 END) AS INT64) AS handled,
       CAST(sum(CASE told WHEN 1 THEN 1 ELSE 0 END) AS INT64) AS hard_only
ORDER BY things DESC, category;
