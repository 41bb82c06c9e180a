SELECT n.text, n.t, n.track, one.label, b.track, two.label, c.track, three.label, d.track,
    d.pose AS answer,
    n.anchor, a.clear AND b.clear AND c.clear AND d.clear AS evidence, a.image, d.ahead
FROM names n JOIN people a USING (t, track)
JOIN hops one ON one.t = n.t AND one.source = n.track
JOIN hops two ON two.t = n.t AND two.source = one.target AND two.target <> n.track
JOIN hops three ON three.t = n.t AND three.source = two.target AND three.target NOT IN (n.track, one.target)
JOIN people b ON b.t = n.t AND b.track = one.target
JOIN people c ON c.t = n.t AND c.track = two.target
JOIN people d ON d.t = n.t AND d.track = three.target AND d.pose IS NOT NULL
WHERE n.general
