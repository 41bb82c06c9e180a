// Actions that annotators labelled as hard, with the number of people and frames.
// param sequence: text
MATCH (p:Person)-[r:Performs]->(a:Action)
WHERE r.sequence = $sequence AND NOT r.certain AND NOT r.gap
RETURN a.name AS action, count(*) AS intervals, CAST(sum(r.last - r.first + 1) AS INT64) AS frames,
       count(DISTINCT p.track) AS people
ORDER BY frames DESC, action;
