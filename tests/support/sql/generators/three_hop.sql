SELECT n.text, n.t, n.track, n.t AS t0, n.track AS a, one.label AS r1, b.track AS b, two.label AS r2, c.track AS c,
    three.label AS r3, d.track AS d,
    d.pose AS answer,
    n.anchor, a.clear AND b.clear AND c.clear AND d.clear AS evidence, a.image, d.ahead,
    read_of(n.track, a.pose) AS stop_0, read_of(b.track, b.pose) AS stop_1, read_of(c.track, c.pose) AS stop_2,
    another(stop_0, answer) AND another(stop_1, answer) AND another(stop_2, answer) AS hop_stop,
    -- From nobody every step leads to the same nobody.
    read_of(apart(coalesce(y.target, x.target), n.track), later.pose) AS skip_1,
    read_of(apart(z.target, n.track), other.pose) AS skip_2,
    another(skip_1, answer) AND another(skip_2, answer) AS hop_skip
FROM names n JOIN people a USING (t, track)
JOIN hops one ON one.t = n.t AND one.source = n.track
JOIN hops two ON two.t = n.t AND two.source = one.target AND two.target <> n.track
JOIN hops three ON three.t = n.t AND three.source = two.target AND three.target NOT IN (n.track, one.target)
JOIN people b ON b.t = n.t AND b.track = one.target
JOIN people c ON c.t = n.t AND c.track = two.target
JOIN people d ON d.t = n.t AND d.track = three.target AND d.pose IS NOT NULL
JOIN steps x ON x.t = n.t AND x.source = n.track AND x.label = two.label
LEFT JOIN steps y ON y.t = n.t AND y.source = x.target AND y.label = three.label
LEFT JOIN people later ON later.t = n.t AND later.track = y.target
JOIN steps z ON z.t = n.t AND z.source = one.target AND z.label = three.label
LEFT JOIN people other ON other.t = n.t AND other.track = z.target
WHERE n.general
