// Things in a sequence by category, and how many of them somebody handles.
// param sequence: text
MATCH (o:Object)
WHERE o.sequence = $sequence
OPTIONAL MATCH (:Person)-[r:Handles]->(o)
WITH o, count(r) AS times
RETURN o.category AS category, count(*) AS things,
       CAST(sum(CASE WHEN times > 0 THEN 1 ELSE 0 END) AS INT64) AS handled
ORDER BY things DESC, category;
