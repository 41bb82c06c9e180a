// The longest conversations of all sequences. A frame without a label, or with a hard label, ends a conversation.
// param count: integer = 20
MATCH (a:Person)-[r:Interacts]->(b:Person)
WHERE r.label = 'conversation' AND r.certain AND a.track < b.track
RETURN r.sequence AS sequence, a.track AS track, b.track AS partner, r.first AS first, r.last AS last,
       round(r.last_s - r.first_s, 1) AS seconds
ORDER BY seconds DESC, track, partner, first, sequence
LIMIT $count;
