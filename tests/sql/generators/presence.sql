-- Judged to the end: `rule` is the first that refuses a candidate.
WITH candidates AS (
    SELECT n.text, n.t, n.track, m1.t AS t1, m2.t AS t2, present_at(m1.seen, m2.seen) AS answer,
        n.anchor, m.clear AS evidence, m.image AND m1.image AND m2.image AS image,
        -- Where the person is in view at the asked times all boxes lie ahead; where at none, the one at t0 does.
        CASE WHEN m1.seen = 0 AND m2.seen = 0 THEN m.ahead
             ELSE (m1.ahead OR m1.seen = 0) AND (m2.ahead OR m2.seen = 0) END AS ahead
    FROM names n JOIN people m USING (t, track)
    JOIN moments m1 ON m1.track = n.track AND m1.t >= n.t + wait() AND m1.seen IS NOT NULL
    JOIN moments m2 ON m2.track = n.track AND m2.t >= m1.t + wait() AND m2.seen IS NOT NULL
    WHERE n.general),
-- time.shift: another answer three seconds earlier or later, as long as it is asked after t0.
shifted AS (
    SELECT DISTINCT c.t, c.track, c.t1, c.t2
    FROM candidates c, (VALUES (-45), (45)) s(frames)
    JOIN moments m1 ON m1.track = c.track AND m1.t = c.t1 + frames AND m1.t > c.t
    JOIN moments m2 ON m2.track = c.track AND m2.t = c.t2 + frames
    WHERE present_at(m1.seen, m2.seen) <> c.answer)
SELECT text, t, track, t1, t2, answer,
    CASE WHEN NOT anchor THEN 'anchor' WHEN NOT evidence THEN 'evidence' WHEN NOT image THEN 'image'
         WHEN ahead THEN 'view.ahead' WHEN (t, track, t1, t2) NOT IN (SELECT (t, track, t1, t2) FROM shifted) THEN 'time.shift'
         -- time.drop: of several pairs of keyframes equally far apart, all give the same answer.
         WHEN count(*) OVER equally_far > 1 AND min(answer) OVER equally_far = max(answer) OVER equally_far
             THEN 'time.drop' END AS rule
FROM candidates
WINDOW equally_far AS (PARTITION BY t, track, t2 - t1)
