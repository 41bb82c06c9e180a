SELECT f.text, one.label, two.label, three.label, count(*) AS defined, count(DISTINCT d.pose) AS answers
FROM fits f
JOIN hops one ON one.t = f.t AND one.source = f.track
JOIN hops two ON two.t = f.t AND two.source = one.target AND two.target <> f.track
JOIN hops three ON three.t = f.t AND three.source = two.target AND three.target NOT IN (f.track, one.target)
JOIN people d ON d.t = f.t AND d.track = three.target AND d.pose IS NOT NULL
GROUP BY f.text, one.label, two.label, three.label
