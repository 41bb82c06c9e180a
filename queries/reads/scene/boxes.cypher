// For the events joins_group and leaves_group: the frames with a box of each person of a sequence.
MATCH (p:Person)-[s:SeenIn]->(:Frame)
WHERE s.sequence IN $scopes
RETURN p.track AS who, s.frame AS frame
ORDER BY who, frame
