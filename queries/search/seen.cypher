// Return how each person of a sequence is seen once per second, and which labels of the person were read.
MATCH (f:Frame) WHERE f.sequence = $sequence AND f.keyframe WITH min(f.frame) % 15 AS phase
MATCH (p:Person)-[s:SeenIn]->(:Frame) WHERE p.sequence = $sequence AND s.frame % 15 = phase
RETURN s.frame AS frame, p.track AS who, s.clear AS clear, s.covered AS covered, s.pose AS pose, s.angle AS angle,
       s.group_size AS group_size, s.group_size_min AS size_min, s.group_size_max AS size_max, s.distance AS distance,
       s.distance_word AS distance_word, s.distance_word_other AS distance_other, s.located AS located, s.face_visible
       AS face, p.gender AS gender, p.age AS age, s.listed AS listed, s.handles_listed AS handles_listed,
       s.interactions_listed AS interactions_listed, s.robot_view_listed AS robot_view_listed, s.person_view_listed AS
       person_view_listed ORDER BY frame, who
