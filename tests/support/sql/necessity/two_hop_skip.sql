SELECT p.text, p.t, p.a, p.r1, p.r2, two.target AS b
FROM paths p JOIN steps two ON two.t = p.t AND two.source = p.a AND two.label = p.r2
