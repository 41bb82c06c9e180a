-- From nobody every step leads to the same nobody.
SELECT p.text, p.t, p.a, p.r1, p.r2,
    f.track AS a, coalesce(one.target, f.track) AS b, coalesce(two.target, one.target, f.track) AS c
FROM paths p JOIN fits f ON f.text = p.text AND f.t = p.t + moved_by()
LEFT JOIN steps one ON one.t = f.t AND one.source = f.track AND one.label = p.r1
LEFT JOIN steps two ON two.t = f.t AND two.source = one.target AND two.label = p.r2
