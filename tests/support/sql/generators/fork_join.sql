SELECT n.text, n.t, n.track, n.t AS t0, n.track AS a, one.label AS r1, b.track AS b, two.label AS r2, c.track AS c,
    j.r3, j.r4, d.track AS d,
    d.pose AS answer,
    n.anchor, a.clear AND b.clear AND c.clear AND d.clear AS evidence, a.image, d.ahead,
    read_of(n.track, a.pose) AS stop_0, read_of(b.track, b.pose) AS stop_1, read_of(c.track, c.pose) AS stop_2,
    -- The branches have no order: it is enough that one of them does not end at the answer.
    another(stop_0, answer) AND (another(stop_1, answer) OR another(stop_2, answer)) AS hop_stop
FROM names n JOIN people a USING (t, track)
JOIN hops one ON one.t = n.t AND one.source = n.track
JOIN hops two ON two.t = n.t AND two.source = n.track AND two.label > one.label AND two.target <> one.target
JOIN joined j ON j.t = n.t AND j.a = n.track AND j.b = one.target AND j.c = two.target
JOIN people b ON b.t = n.t AND b.track = j.b
JOIN people c ON c.t = n.t AND c.track = j.c
JOIN people d ON d.t = n.t AND d.track = j.d AND d.pose IS NOT NULL
WHERE n.general
