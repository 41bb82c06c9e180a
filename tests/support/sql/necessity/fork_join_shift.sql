-- From nobody every step leads to the same nobody.
SELECT n.text, n.t, n.track, one.label, two.label,
    CASE WHEN f.track >= 0 THEN f.track END AS a,
    CASE WHEN left_.target >= 0 THEN left_.target END AS b, CASE WHEN right_.target >= 0 THEN right_.target END AS c,
    read_of(f.track, NULL) AS a_outcome, read_of(coalesce(left_.target, f.track), NULL) AS b_outcome,
    read_of(coalesce(right_.target, f.track), NULL) AS c_outcome
FROM names n JOIN people a USING (t, track)
JOIN hops one ON one.t = n.t AND one.source = n.track
JOIN hops two ON two.t = n.t AND two.source = n.track AND two.label > one.label AND two.target <> one.target
JOIN people b ON b.t = n.t AND b.track = one.target
JOIN people c ON c.t = n.t AND c.track = two.target
JOIN fits f ON f.text = n.text AND f.t = n.t + moved_by()
LEFT JOIN steps left_ ON left_.t = f.t AND left_.source = f.track AND left_.label = one.label
LEFT JOIN steps right_ ON right_.t = f.t AND right_.source = f.track AND right_.label = two.label
WHERE n.general AND n.anchor AND a.clear AND b.clear AND c.clear AND a.image
