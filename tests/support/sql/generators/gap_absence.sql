SELECT n.text, n.t, n.track, n.t AS t0, n.track AS a, g.leaves, g.returns, (g.returns - g.leaves) / 15::DOUBLE AS value,
    n.anchor, m.clear AND g.clear AS evidence, m.image AND g.image AS image, g.ahead
FROM names n JOIN people m USING (t, track) JOIN absences g USING (track)
WHERE n.general AND g.leaves >= n.t + wait() AND g.returns >= g.leaves + least_gap()
    -- Present at every keyframe until then.
    AND (SELECT count(*) FROM keyframes k WHERE k.t >= n.t AND k.t < g.leaves)
        = (SELECT count(*) FROM people p WHERE p.track = n.track AND p.t >= n.t AND p.t < g.leaves AND p.clear)
