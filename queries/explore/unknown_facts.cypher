// Labels that are not certain, by action: number of intervals, number of frames in them, and number of people.
MATCH (p:Person)-[r:Performs]->(a:Action)
WHERE r.sequence = $sequence AND NOT r.certain
RETURN a.name AS action, count(*) AS intervals, CAST(sum(r.last - r.first + 1) AS INT64) AS frames,
       count(DISTINCT p.track) AS people
ORDER BY frames DESC, action;
