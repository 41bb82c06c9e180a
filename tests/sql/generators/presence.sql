SELECT n.text, n.t, n.track, m1.t, n.track, m2.t, n.track,
    present_at(m1.seen, m2.seen) AS answer,
    n.anchor, m.clear AS evidence, m.image AND m1.image AND m2.image AS image,
    -- Where the person is in view at the asked times all boxes lie ahead; where at none, the one at t0 does.
    CASE WHEN m1.seen = 0 AND m2.seen = 0 THEN m.ahead
         ELSE (m1.ahead OR m1.seen = 0) AND (m2.ahead OR m2.seen = 0) END AS ahead
FROM names n JOIN people m USING (t, track)
JOIN moments m1 ON m1.track = n.track AND m1.t >= n.t + wait() AND m1.seen IS NOT NULL
JOIN moments m2 ON m2.track = n.track AND m2.t >= m1.t + wait() AND m2.seen IS NOT NULL
WHERE n.general
