SELECT n.text, n.t, n.track, n.t AS t0, n.track AS a, later.t AS t1, later.pose AS answer,
    n.anchor, m.clear AND later.clear AS evidence, m.image AND later.image AS image, later.ahead
FROM names n JOIN people m USING (t, track)
JOIN people later ON later.track = n.track AND later.t >= n.t + wait() AND later.pose <> m.pose
WHERE n.poseless
