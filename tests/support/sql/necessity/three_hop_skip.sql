SELECT p.text, p.t, p.a, p.r1, p.r2, p.r3, one.target AS b, coalesce(two.target, one.target) AS c
FROM paths p
JOIN steps one ON one.t = p.t AND one.source = p.a AND one.label = CASE skipped() WHEN 1 THEN p.r2 ELSE p.r1 END
LEFT JOIN steps two ON two.t = p.t AND two.source = one.target AND two.label = p.r3
