SELECT n.text, n.t, n.track, n.t AS t0, n.track AS a, n.anchor, m.clear AS evidence, m.image, m.ahead
FROM names n JOIN people m USING (t, track)
WHERE n.general
