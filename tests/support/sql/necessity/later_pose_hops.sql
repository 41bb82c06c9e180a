SELECT p.text, p.t, p.track, p.t1, p.r1, p.r2,
    read_later(first_.seen, first_.pose) AS stop_0, read_later(second_.seen, second_.pose) AS stop_1,
    another(stop_0, answer) AND another(stop_1, answer) AS hop_stop,
    CASE WHEN x.target >= 0 THEN read_later(other.seen, other.pose) ELSE read_of(x.target, NULL) END AS skip_1,
    another(skip_1, answer) AS hop_skip
FROM later_pose p
LEFT JOIN moments first_ ON first_.t = p.t1 AND first_.track = p.a
LEFT JOIN moments second_ ON second_.t = p.t1 AND second_.track = p.b
JOIN steps x ON x.t = p.t0 AND x.source = p.a AND x.label = p.r2
LEFT JOIN moments other ON other.t = p.t1 AND other.track = x.target
WHERE anchor AND evidence AND p.image AND NOT p.ahead
