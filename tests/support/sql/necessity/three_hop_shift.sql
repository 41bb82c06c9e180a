SELECT p.text, p.t, p.a, p.r1, p.r2, p.r3,
    f.track AS a, coalesce(one.target, f.track) AS b, coalesce(two.target, one.target, f.track) AS c,
    coalesce(three.target, two.target, one.target, f.track) AS d
FROM paths p JOIN fits f ON f.text = p.text AND f.t = p.t + moved_by()
LEFT JOIN steps one ON one.t = f.t AND one.source = f.track AND one.label = p.r1
LEFT JOIN steps two ON two.t = f.t AND two.source = one.target AND two.label = p.r2
LEFT JOIN steps three ON three.t = f.t AND three.source = two.target AND three.label = p.r3
