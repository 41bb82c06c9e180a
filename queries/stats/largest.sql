-- The largest box in clear view of each sequence, at the frame nearest to its middle that has a clear view.
SELECT sequence, frame, x, y, w, h
FROM intervals_sightings
JOIN intervals_sequence USING (sequence)
WHERE clear
QUALIFY row_number() OVER (
    PARTITION BY sequence ORDER BY abs(2 * frame - frame_count), frame, w * h DESC, track) = 1
ORDER BY sequence;
