SELECT n.text, n.t, n.track, n.t AS t0, n.track AS a, one.label AS r1, b.track AS b, two.label AS r2, c.track AS c,
    c.pose AS answer,
    n.anchor, a.clear AND b.clear AND c.clear AS evidence, a.image, c.ahead,
    read_of(n.track, a.pose) AS stop_0, read_of(b.track, b.pose) AS stop_1,
    another(stop_0, answer) AND another(stop_1, answer) AS hop_stop,
    read_of(x.target, other.pose) AS skip_1, another(skip_1, answer) AS hop_skip
FROM names n JOIN people a USING (t, track)
JOIN hops one ON one.t = n.t AND one.source = n.track
JOIN hops two ON two.t = n.t AND two.source = one.target AND two.target <> n.track
JOIN people b ON b.t = n.t AND b.track = one.target
JOIN people c ON c.t = n.t AND c.track = two.target AND c.pose IS NOT NULL
JOIN steps x ON x.t = n.t AND x.source = n.track AND x.label = two.label
LEFT JOIN people other ON other.t = n.t AND other.track = x.target
WHERE n.general
