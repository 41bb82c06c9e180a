// All people at one frame, clockwise from behind the robot: gender, pose, direction, distance and size of the group.
// param frame: integer
MATCH (p:Person)-[seen:SeenIn]->(:Frame)
WHERE seen.sequence = $sequence AND seen.frame = $frame
RETURN p.track AS track, p.gender AS gender, seen.pose AS pose, round(seen.angle, 1) AS angle, seen.sector AS sector,
       round(seen.distance, 1) AS m, seen.group_size AS group_of, seen.clear AS clear
ORDER BY angle, track;
