SELECT p.text, p.t, p.a, p.r1, p.r2, p.r3, count(*) AS defined, count(DISTINCT d.pose) AS answers
FROM paths p JOIN fits f ON f.text = p.text
JOIN hops one ON one.t = f.t AND one.source = f.track AND one.label = p.r1
JOIN hops two ON two.t = f.t AND two.source = one.target AND two.label = p.r2 AND two.target <> f.track
JOIN hops three ON three.t = f.t AND three.source = two.target AND three.label = p.r3
    AND three.target NOT IN (f.track, one.target)
JOIN people d ON d.t = f.t AND d.track = three.target AND d.pose IS NOT NULL
GROUP BY p.text, p.t, p.a, p.r1, p.r2, p.r3
