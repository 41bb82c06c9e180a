-- Causes of wrong evidence boxes. Each box counts for the first cause that applies, in percent of the run's questions.
WITH boxes AS (
    SELECT s.run_id, s.question_id, q.sequence, p.evidence_frame AS frame,
           p.evidence_x AS x, p.evidence_y AS y, p.evidence_w AS w, p.evidence_h AS h,
           status <> 'error' AND frame >= 0 AND isfinite(x) AND isfinite(y) AND isfinite(w) AND isfinite(h) AS readable
    FROM scores s
    JOIN questions q USING (question_id)
    LEFT JOIN predictions p USING (run_id, question_id)
    WHERE s.evidence_score = 0
), looks AS (
    SELECT run_id, question_id, TRY_CAST(shown[1] AS INT) AS frame,
           coalesce(TRY_CAST(shown[2] AS INT), 0) AS start, if(shown[2] IS NULL, 3760, 480) AS width
    FROM (
        SELECT run_id, question_id, TRY(json_extract_string(response, ['$.frame_id', '$.left'])) AS shown
        FROM steps
        WHERE kind = 'observe'
    )
), target AS (
    SELECT question_id, e.frame, e.x, e.y, e.w, e.h
    FROM questions q
    JOIN answers a USING (question_id)
    JOIN evidence e ON e.sequence = q.sequence AND e.track = a.target_track
), reached AS (
    -- Columns of the target's box, counted from the left edge of the look. A box may cross the seam or that edge.
    SELECT l.run_id, l.question_id, l.width, e.w,
           e.x - l.start - 3760 * floor((e.x - l.start) / 3760) AS first, first + e.w AS last
    FROM looks l
    JOIN target e USING (question_id, frame)
), looked AS (
    SELECT DISTINCT run_id, question_id
    FROM reached
    WHERE greatest(0, least(last, width) - first) + greatest(0, least(last - 3760, width)) >= 0.5 * w
), people AS (
    SELECT b.*, TRUE AS target, e.x AS px, e.y AS py, e.w AS pw, e.h AS ph
    FROM boxes b
    JOIN target e USING (question_id, frame)
    UNION ALL
    SELECT b.*, FALSE, o.x, o.y, o.w, o.h
    FROM boxes b
    JOIN intervals_sightings o USING (sequence, frame)
), overlapping AS (
    SELECT run_id, question_id, target, px + 3760 * round((x + w / 2 - px - pw / 2) / 3760) AS sx,
           greatest(0, least(x + w, sx + pw) - greatest(x, sx))
           * greatest(0, least(y + h, py + ph) - greatest(y, py)) AS both_px,
           both_px / (w * h + pw * ph - both_px) AS iou
    FROM people
), best AS (
    SELECT run_id, question_id, bool_or(target) AS present, max(iou) AS overlap, max(iou) FILTER (target) AS own
    FROM overlapping
    GROUP BY run_id, question_id
), judged AS (
    SELECT run_id, question_id,
           CASE WHEN readable IS NOT TRUE THEN 1 WHEN l.question_id IS NULL THEN 2 WHEN present IS NOT TRUE THEN 3
                WHEN own > 0 AND own = overlap THEN 4 WHEN overlap > 0 THEN 5 ELSE 6 END AS place
    FROM boxes
    LEFT JOIN looked l USING (run_id, question_id)
    LEFT JOIN best USING (run_id, question_id)
), causes (place, cause) AS (
    VALUES (1, 'no box'), (2, 'never looked there'), (3, 'frame where the target is absent'),
           (4, 'right person, loose box'), (5, 'wrong person'), (6, 'nobody')
)
SELECT r.run_id, cause, n, count(j.question_id) AS times, round_even(100 * times / n, 2) AS percent
FROM (SELECT run_id, count(*) AS n FROM scores GROUP BY run_id) r
CROSS JOIN causes
LEFT JOIN judged j ON j.run_id = r.run_id AND j.place = causes.place
GROUP BY r.run_id, causes.place, cause, n
ORDER BY r.run_id, causes.place;
