SELECT p.text, p.t, p.a, p.r1, p.r2, count(*) AS defined, count(DISTINCT c.pose) AS answers
FROM paths p JOIN fits f ON f.text = p.text
JOIN hops one ON one.t = f.t AND one.source = f.track AND one.label = p.r1
JOIN hops two ON two.t = f.t AND two.source = one.target AND two.label = p.r2 AND two.target <> f.track
JOIN people c ON c.t = f.t AND c.track = two.target AND c.pose IS NOT NULL
GROUP BY p.text, p.t, p.a, p.r1, p.r2
