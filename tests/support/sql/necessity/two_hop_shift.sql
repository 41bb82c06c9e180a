SELECT p.text, p.t, p.track, p.r1, p.r2,
    -- From nobody every step leads to the same nobody; whoever comes back finds nobody.
    CASE WHEN two.target = f.track THEN 'empty'
         ELSE read_of(coalesce(two.target, one.target, f.track), c.pose) END AS answer
FROM two_hop p JOIN fits f ON f.text = p.text AND f.t = p.t0 + moved_by()
LEFT JOIN steps one ON one.t = f.t AND one.source = f.track AND one.label = p.r1
LEFT JOIN steps two ON two.t = f.t AND two.source = one.target AND two.label = p.r2
LEFT JOIN people c ON c.t = f.t AND c.track = two.target
WHERE anchor AND evidence AND p.image AND NOT p.ahead AND hop_stop
