SELECT n.text, n.t, n.track, n.t AS t1, n.track AS a, later.t AS t2, n.t, n.track, w.label, w.label AS r1,
    count(*) FILTER (w.met <= later.t)::DOUBLE AS value,
    any_value(n.anchor) AS anchor,
    any_value(m.clear) AND count(*) FILTER (w.seen <= later.t) = value AS evidence,
    any_value(m.image) AND count(*) FILTER (w.seen <= later.t AND w.image) = value AS image,
    any_value(m.ahead) AS ahead
FROM names n JOIN people m USING (t, track) JOIN meetings w USING (t, track)
JOIN people later ON later.track = n.track AND later.t >= n.t + long_wait() AND later.t < w.ends
WHERE n.general
GROUP BY n.text, n.t, n.track, later.t, w.label
HAVING value >= least_people() AND count(*) FILTER (w.maybe <= later.t AND (w.met <= later.t) IS NOT TRUE) = 0
