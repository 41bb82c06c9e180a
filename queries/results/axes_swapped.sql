-- Number of evidence boxes that are right as written, and number that would be right if x and y were exchanged.
-- This shows whether a model writes its boxes in another order of axes. It does not change scores. A box counts only
-- if the position of the picture in which it was read is known.
-- A box is right if its IoU is at least 0.5, also across the seam.
WITH solved AS (
    SELECT run_id, question_id, step, CASE WHEN json_valid(request) THEN request::JSON END AS shown,
           CASE WHEN json_valid(response) THEN response::JSON END AS told
    FROM steps
    WHERE kind = 'solve'
), placed AS (
    SELECT run_id, question_id, evidence_frame AS frame,
           TRY_CAST(shown -> '$.width' AS DOUBLE) AS width, TRY_CAST(shown -> '$.height' AS DOUBLE) AS height,
           TRY_CAST(shown -> '$.left' AS DOUBLE) AS start, TRY_CAST(told -> '$.image_box' AS DOUBLE[]) AS box
    FROM solved
    JOIN predictions USING (run_id, question_id)
    WHERE TRY_CAST(told -> '$.stitched_box' AS DOUBLE[]) = [evidence_x, evidence_y, evidence_w, evidence_h]
      AND len(TRY_CAST(told -> '$.image_box' AS DOUBLE[])) = 4
    QUALIFY row_number() OVER (PARTITION BY run_id, question_id ORDER BY step DESC) = 1
), readings AS (
    SELECT run_id, question_id, frame, FALSE AS swapped,
           start + box[1] AS x, box[2] AS y, box[3] AS w, box[4] AS h
    FROM placed
    UNION ALL
    SELECT run_id, question_id, frame, TRUE,
           start + box[2] / height * width, box[1] / width * height, box[4] / height * width, box[3] / width * height
    FROM placed
), target AS (
    SELECT question_id, e.frame, e.x, e.y, e.w, e.h
    FROM questions q
    JOIN answers a USING (question_id)
    JOIN evidence e ON e.sequence = q.sequence AND e.track = a.target_track
), shifted AS (
    SELECT r.*, e.y AS ey, e.w AS ew, e.h AS eh,
           e.x + 3760 * round((r.x + r.w / 2 - e.x - e.w / 2) / 3760) AS ex
    FROM readings r
    LEFT JOIN target e USING (question_id, frame)
), overlapping AS (
    SELECT *, greatest(least(x + w, ex + ew) - greatest(x, ex), 0)
              * greatest(least(y + h, ey + eh) - greatest(y, ey), 0) AS both_px
    FROM shifted
)
SELECT run_id, count(*) FILTER (NOT swapped) AS boxes,
       count(*) FILTER (NOT swapped AND both_px / (w * h + ew * eh - both_px) >= 0.5) AS right_as_read,
       count(*) FILTER (swapped AND both_px / (w * h + ew * eh - both_px) >= 0.5) AS right_if_swapped
FROM overlapping
GROUP BY run_id
ORDER BY run_id;
