SELECT n.text, n.t, n.track, n.t AS t0, n.track AS a, later.t AS t1,
    distance_change(m.distance, later.distance, later.seen) AS answer,
    n.anchor, m.clear AND later.seen IS NOT NULL AS evidence, m.image AND later.image AS image,
    CASE WHEN later.seen = 0 THEN m.ahead ELSE later.ahead END AS ahead
FROM names n JOIN people m USING (t, track)
JOIN moments later ON later.track = n.track AND later.t >= n.t + wait()
WHERE n.general AND answer IS NOT NULL
