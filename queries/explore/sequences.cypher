// All loaded sequences, with the numbers of frames, people and groups, and with the annotation layers.
MATCH (s:Sequence)
OPTIONAL MATCH (p:Person)
WHERE p.sequence = s.sequence
WITH s, count(p) AS people
OPTIONAL MATCH (g:SocialGroup)
WHERE g.sequence = s.sequence
WITH s, people, count(g) AS groups
RETURN s.sequence AS sequence, s.frame_count AS frames, people, groups, s.action_step AS action_step,
       s.layers AS layers
ORDER BY sequence;
