-- What begins and ends: stable segments with the boxes at their edges, poses held, and absences.

CREATE TABLE starts AS
    SELECT s.track, s.action, s.start, s.first, s.last, s.quiet_from, s.closed, a.angle,
        a.clear AS first_clear, a.image AS first_image, a.ahead AS first_ahead,
        b.clear AS last_clear, b.image AS last_image, b.ahead AS last_ahead
    FROM segments s
    JOIN boxes a ON a.track = s.track AND a.frame = s.first
    JOIN boxes b ON b.track = s.track AND b.frame = s.last;

-- Longest runs of keyframes, a second apart, at which a person holds one pose.
CREATE TABLE held_poses AS
    SELECT track, pose, min(t) AS since, max(t) AS until
    FROM (SELECT *, t - 15 * row_number() OVER (PARTITION BY track, pose ORDER BY t) AS run FROM people
          WHERE pose IS NOT NULL)
    GROUP BY track, pose, run;

-- From the last box before to the first one after, with every frame between them annotated and the person absent at a
-- keyframe of it.
CREATE TABLE absences AS
    WITH holes AS (
        SELECT track, frame AS leaves, lead(frame) OVER one AS returns,
            clear AND lead(clear) OVER one AS clear, image AND lead(image) OVER one AS image,
            ahead AND lead(ahead) OVER one AS ahead
        FROM boxes WINDOW one AS (PARTITION BY track ORDER BY frame)),
    grid AS (
        SELECT CASE WHEN bool_and(step % 15 = 0) THEN 15 ELSE 1 END AS step
        FROM (SELECT frame - lag(frame) OVER (ORDER BY frame) AS step FROM frames WHERE annotated))
    SELECT h.* FROM holes h, grid
    WHERE returns > leaves + 1
        AND EXISTS (FROM absent a WHERE a.track = h.track AND a.t BETWEEN leaves AND returns)
        AND NOT EXISTS (
            FROM range(leaves + step, returns, step) between_(frame)
            WHERE between_.frame NOT IN (SELECT frame FROM frames WHERE annotated));
