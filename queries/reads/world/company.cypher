// count: how many different people are in a relation with somebody at any frame from one to another, both says that it
// holds both ways.
UNWIND $plans AS q
WITH beliefs, q.id AS id, q.who AS who, q.relation AS relation, q.both AS both, q.t1 AS t1, q.t2 AS t2
UNWIND beliefs AS b
WITH id, who, relation, both, t1, t2, b
WHERE b.other <> '' AND b.name = relation AND b.first <= t2 AND b.last >= t1 AND (b.id = who OR (both AND b.other = who))
WITH id, CASE WHEN b.id = who THEN b.other ELSE b.id END AS other
RETURN id, count(DISTINCT other) AS people
ORDER BY id
