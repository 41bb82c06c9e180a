-- The pose of t0 is held until the keyframe before the one at which a segment of another pose has just begun.
SELECT n.text, n.t, n.track, n.t AS t0, n.track AS a, s.action, s.start, s.action AS answer,
    n.anchor, m.clear AND s.first_clear AS evidence, m.image AND s.first_image AS image, s.first_ahead AS ahead
FROM names n JOIN people m USING (t, track)
JOIN held_poses h ON h.track = n.track AND n.t BETWEEN h.since AND h.until
JOIN starts s ON s.track = n.track AND s.action <> h.pose AND s.first > h.until AND s.first <= h.until + 15
JOIN people next ON next.track = n.track AND next.t = h.until + 15 AND next.pose = s.action
WHERE n.poseless AND h.until >= n.t + long_wait()
