// What is loaded: every sequence with its frames, people, groups and layers.
MATCH (s:Sequence)
OPTIONAL MATCH (p:Person)
WHERE p.sequence = s.sequence
WITH s, count(p) AS people
RETURN s.sequence AS sequence, s.fps AS fps, s.frame_count AS frames, people, s.layers AS layers,
       s.action_step AS action_step
ORDER BY sequence;
