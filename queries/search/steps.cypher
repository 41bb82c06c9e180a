// Decide whom each relation leads to from each moment: one person, several, or unknown.
// The one person who certainly has it while nobody else could, else the number of the moment that stands for the
// outcome, ambiguous (-2) or unknown (-3).
// param sequence: text
MATCH (a:Moment)-[f:Fact]->(b:Moment)
WHERE a.id >= $low AND a.id < $high
  AND b.id >= $low AND b.id < $high
WITH a.id AS a, f.relation AS relation, count(*) AS facts, sum(CASE WHEN f.certain = true THEN 1 ELSE 0 END) AS certain,
     sum(CASE WHEN f.unread = true THEN 1 ELSE 0 END) AS unread, min(f.unknown) AS unknown, min(b.id) AS b
RETURN a - $low AS source, relation,
       CASE WHEN facts + unknown - unread = 1 AND certain = 1 THEN b - $low
            WHEN certain >= 2 THEN -2 ELSE -3 END AS target
ORDER BY source, relation
