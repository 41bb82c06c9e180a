SELECT f.text, one.label, two.label, count(*) AS defined, count(DISTINCT c.pose) AS answers
FROM fits f
JOIN hops one ON one.t = f.t AND one.source = f.track
JOIN hops two ON two.t = f.t AND two.source = one.target AND two.target <> f.track
JOIN people c ON c.t = f.t AND c.track = two.target AND c.pose IS NOT NULL
GROUP BY f.text, one.label, two.label
