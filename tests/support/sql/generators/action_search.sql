SELECT n.text, n.t, n.track, n.t AS t0, n.track AS a, one.label, b.track, two.label, c.track, s.action, s.start,
    n.anchor, a.clear AND b.clear AND c.clear AND s.first_clear AS evidence, a.image AND s.first_image AS image,
    s.first_ahead AS ahead,
    CASE WHEN x.target >= 0 THEN x.target END AS skip_1_person, read_of(x.target, NULL) AS skip_1
FROM names n JOIN people a USING (t, track)
JOIN hops one ON one.t = n.t AND one.source = n.track
JOIN hops two ON two.t = n.t AND two.source = one.target AND two.target <> n.track
JOIN people b ON b.t = n.t AND b.track = one.target
JOIN people c ON c.t = n.t AND c.track = two.target
JOIN starts s ON s.track = c.track AND s.start >= n.t + search_wait() AND s.quiet_from <= n.t
JOIN steps x ON x.t = n.t AND x.source = n.track AND x.label = two.label
WHERE n.general AND least(abs(s.angle - c.angle), 360 - abs(s.angle - c.angle)) > turn_degrees()
