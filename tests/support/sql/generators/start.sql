SELECT n.text, n.t, n.track, n.t AS t0, n.track AS a, s.action, s.start,
    n.anchor, m.clear AND s.first_clear AS evidence, m.image AND s.first_image AS image, s.first_ahead AS ahead
FROM names n JOIN people m USING (t, track) JOIN starts s USING (track)
WHERE n.general AND s.start >= n.t + wait() AND s.quiet_from <= n.t
