// Return who is seen at each keyframe of a sequence, how each person is seen, and which labels were read.
// param sequence: text
MATCH (p:Person)-[s:SeenIn]->(f:Frame)
WHERE s.sequence = $sequence AND f.keyframe
RETURN s.frame AS frame, p.track AS who, s.clear AS clear, s.pose AS pose, s.angle AS angle, s.box AS box, f.image AS image,
       s.group_size AS group_size, s.distance_word AS distance_word, s.distance_word_other AS distance_other,
       s.distance AS distance, s.located AS located, s.face_visible AS face, p.gender AS gender, p.age AS age,
       s.listed AS listed, s.handles_listed AS handles_listed, s.interactions_listed AS interactions_listed
ORDER BY frame, who
