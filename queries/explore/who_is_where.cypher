// Everybody at one frame: direction, distance, pose and visibility, clockwise from behind the robot.
// param sequence = "gates-ai-lab-2019-02-08_0"
// param frame = 15
MATCH (p:Person)-[seen:SeenIn]->(:Frame)
WHERE seen.sequence = $sequence AND seen.frame = $frame
RETURN p.track AS track, p.gender AS gender, p.age AS age, seen.pose AS pose, seen.angle AS angle,
       seen.sector AS sector, seen.distance AS distance, seen.group_size AS group_size, seen.clear AS clear,
       seen.occlusion AS occlusion
ORDER BY angle, track;
