// Pairs of people who have conversations, with the total time, longest first. Labels marked as hard do not count.
MATCH (a:Person)-[r:Interacts]->(b:Person)
WHERE r.sequence = $sequence AND r.label = 'conversation' AND r.certain AND a.track < b.track
RETURN a.track AS track, b.track AS partner, round(sum(r.last_s - r.first_s), 1) AS seconds, count(*) AS talks,
       min(r.first) AS first, max(r.last) AS last
ORDER BY seconds DESC, track, partner;
