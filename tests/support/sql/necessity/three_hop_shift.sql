SELECT p.text, p.t, p.track, p.r1, p.r2, p.r3,
    -- From nobody every step leads to the same nobody; nor does anybody count who was passed through already.
    CASE WHEN two.target = f.track OR three.target IN (f.track, one.target) THEN 'empty'
         ELSE read_of(coalesce(three.target, two.target, one.target, f.track), d.pose) END AS answer
FROM three_hop p JOIN fits f ON f.text = p.text AND f.t = p.t0 + moved_by()
LEFT JOIN steps one ON one.t = f.t AND one.source = f.track AND one.label = p.r1
LEFT JOIN steps two ON two.t = f.t AND two.source = one.target AND two.label = p.r2
LEFT JOIN steps three ON three.t = f.t AND three.source = two.target AND three.label = p.r3
LEFT JOIN people d ON d.t = f.t AND d.track = three.target
WHERE anchor AND evidence AND p.image AND NOT p.ahead AND hop_stop
