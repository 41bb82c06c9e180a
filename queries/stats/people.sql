-- Every box of a person, by person and frame. `seen` is true for a clear view at a keyframe; `actions` lists the actions
-- that are certain then. `key` grows by one from frame to frame.
WITH doing AS (
    SELECT sequence, track, frame, list(DISTINCT action) AS actions
    FROM intervals_sightings
    JOIN intervals_frames USING (sequence, frame)
    JOIN intervals_actions USING (sequence, track)
    WHERE keyframe AND clear AND certain AND frame BETWEEN first AND last
    GROUP BY sequence, track, frame
)
SELECT sequence, frame, dense_rank() OVER (ORDER BY sequence, track) * 16777216 + frame AS key,
       keyframe AND clear AS seen, frame_count - frame AS frames_left, coalesce(actions, []) AS actions
FROM intervals_sightings
JOIN intervals_frames USING (sequence, frame)
JOIN intervals_sequence USING (sequence)
LEFT JOIN doing USING (sequence, track, frame)
ORDER BY key;
