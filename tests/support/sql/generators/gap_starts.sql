SELECT n.text, n.t, n.track, n.t AS t0, n.track AS a, one.action, one.start, two.action, two.start,
    (two.start - one.start) / 15::DOUBLE AS value,
    n.anchor, m.clear AND one.first_clear AND two.first_clear AS evidence,
    m.image AND one.first_image AND two.first_image AS image, one.first_ahead AND two.first_ahead AS ahead
FROM names n JOIN people m USING (t, track)
JOIN starts one ON one.track = n.track AND one.quiet_from <= n.t AND one.start >= n.t + wait()
JOIN starts two ON two.track = n.track AND two.quiet_from <= n.t AND two.start >= one.start + least_gap()
WHERE n.general AND one.action <> two.action
