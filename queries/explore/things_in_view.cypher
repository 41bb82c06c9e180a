// Things with their boxes at one frame of the panoptic layer (one frame per second), clockwise from behind the robot.
// param frame: integer
MATCH (o:Object)-[seen:SeenIn]->(:Frame)
WHERE seen.sequence = $sequence AND seen.frame = $frame
RETURN o.category AS category, o.track AS thing, round(seen.angle, 1) AS angle, round(seen.box.x, 1) AS x,
       round(seen.box.y, 1) AS y, round(seen.box.w, 1) AS w, round(seen.box.h, 1) AS h
ORDER BY angle, thing, category;
