// Things that each person handles, with the verb and the total time. Labels marked as hard do not count.
MATCH (p:Person)-[r:Handles]->(o:Object)
WHERE r.sequence = $sequence AND r.certain
RETURN p.track AS track, r.verb AS verb, o.category AS category, o.track AS thing, min(r.first) AS first,
       round(sum(r.last_s - r.first_s), 1) AS seconds
ORDER BY track, first, thing, verb, category;
