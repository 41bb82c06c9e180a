-- Judged to the end: `rule` is the first that refuses a candidate.
WITH asked AS (
    -- Somebody's presence at a keyframe, and three seconds earlier and later.
    SELECT m.t, m.track, m.seen, m.image, m.ahead, earlier.seen AS earlier, later.seen AS later
    FROM moments m
    LEFT JOIN moments earlier ON earlier.track = m.track AND earlier.t = m.t - 45
    LEFT JOIN moments later ON later.track = m.track AND later.t = m.t + 45
    WHERE m.seen IS NOT NULL),
candidates AS (
    SELECT n.text, n.t, n.track, m1.t AS t1, m2.t AS t2, present_at(m1.seen, m2.seen) AS answer,
        n.anchor, m.clear AS evidence, m.image AND m1.image AND m2.image AS image,
        -- Where the person is in view at the asked times all boxes lie ahead; where at none, the one at t0 does.
        CASE WHEN m1.seen = 0 AND m2.seen = 0 THEN m.ahead
             ELSE (m1.ahead OR m1.seen = 0) AND (m2.ahead OR m2.seen = 0) END AS ahead,
        -- time.shift: another answer three seconds earlier, as long as that is after t0, or later.
        CASE WHEN m1.t - 45 > n.t THEN present_at(m1.earlier, m2.earlier) <> answer END IS TRUE
            OR (present_at(m1.later, m2.later) <> answer) IS TRUE AS shifts
    FROM names n JOIN people m USING (t, track)
    JOIN asked m1 ON m1.track = n.track AND m1.t >= n.t + wait()
    JOIN asked m2 ON m2.track = n.track AND m2.t >= m1.t + wait()
    WHERE n.general)
SELECT text, t, track, t1, t2, answer,
    CASE WHEN NOT anchor THEN 'anchor' WHEN NOT evidence THEN 'evidence' WHEN NOT image THEN 'image'
         WHEN ahead THEN 'view.ahead' WHEN NOT shifts THEN 'time.shift'
         -- time.drop: of several pairs of keyframes equally far apart, all give the same answer.
         WHEN count(*) OVER equally_far > 1 AND min(answer) OVER equally_far = max(answer) OVER equally_far
             THEN 'time.drop' END AS rule
FROM candidates
WINDOW equally_far AS (PARTITION BY t, track, t2 - t1)
