// Actions with labels that are not certain: number of such intervals, of their frames, and of people.
// param sequence: text
MATCH (p:Person)-[r:Performs]->(a:Action)
WHERE r.sequence = $sequence AND NOT r.certain
RETURN a.name AS action, count(*) AS intervals, CAST(sum(r.last - r.first + 1) AS INT64) AS frames,
       count(DISTINCT p.track) AS people
ORDER BY frames DESC, action;
