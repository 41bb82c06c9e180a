SELECT n.text, n.t, n.track, one.label, b.track, two.label, c.track, j.r3, j.r4, d.track,
    d.pose AS answer,
    n.anchor, a.clear AND b.clear AND c.clear AND d.clear AS evidence, a.image, d.ahead
FROM names n JOIN people a USING (t, track)
JOIN hops one ON one.t = n.t AND one.source = n.track
JOIN hops two ON two.t = n.t AND two.source = n.track AND two.label > one.label AND two.target <> one.target
JOIN joined j ON j.t = n.t AND j.a = n.track AND j.b = one.target AND j.c = two.target
JOIN people b ON b.t = n.t AND b.track = j.b
JOIN people c ON c.t = n.t AND c.track = j.c
JOIN people d ON d.t = n.t AND d.track = j.d AND d.pose IS NOT NULL
WHERE n.general
