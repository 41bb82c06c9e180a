SELECT n.text, n.t, n.track, n.t AS t0, n.track AS a, one.label AS r1, b.track AS b, two.label AS r2, c.track AS c,
    later.t AS t1, later.pose AS answer,
    n.anchor, a.clear AND b.clear AND c.clear AND later.clear AS evidence, a.image AND later.image AS image, later.ahead
FROM names n JOIN people a USING (t, track)
JOIN hops one ON one.t = n.t AND one.source = n.track
JOIN hops two ON two.t = n.t AND two.source = one.target AND two.target <> n.track
JOIN people b ON b.t = n.t AND b.track = one.target
JOIN people c ON c.t = n.t AND c.track = two.target
JOIN people later ON later.track = c.track AND later.t >= n.t + long_wait() AND later.pose <> c.pose
WHERE n.general
