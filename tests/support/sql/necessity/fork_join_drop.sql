SELECT p.text, p.t, p.a, p.r1, p.r2, p.r3, p.r4, f.t, f.track AS a, one.target AS b, two.target AS c
FROM paths p JOIN fits f ON f.text = p.text
JOIN hops one ON one.t = f.t AND one.source = f.track AND one.label = p.r1
JOIN hops two ON two.t = f.t AND two.source = f.track AND two.label = p.r2 AND two.target <> one.target
