-- Who is there at each keyframe, from the tables sequence, frames, persons and sightings.
-- A *moment* is a person at a keyframe with a box, or one from which the person is certainly absent.

CREATE TABLE keyframes AS SELECT unnest(keyframes) AS t FROM sequence;

-- Where a sequence has no image at all, every frame passes.
CREATE TABLE pictures AS
    SELECT frame, image OR NOT list_contains(layers, 'images') AS image FROM frames, sequence;

-- At least half of a box lies in the view straight ahead, columns 1640 to 2120, across the seam.
CREATE MACRO in_front(x, w) AS
    list_max([least(x + w, 2120 + turn) - greatest(x, 1640 + turn) FOR turn IN [-3760, 0, 3760]]) >= w / 2;

CREATE TABLE boxes AS
    SELECT s.* REPLACE (CASE WHEN located THEN distance END AS distance), in_front(x, w) AS ahead, image
    FROM sightings s JOIN pictures USING (frame);

CREATE TABLE people AS
    SELECT * EXCLUDE frame, frame AS t, row_number() OVER (PARTITION BY frame ORDER BY track) - 1 AS slot
    FROM boxes JOIN keyframes ON t = frame;

-- Absent: the frame, and those a second before and after, are annotated and hold no box of the person.
CREATE TABLE absent AS
    SELECT t, p.track
    FROM (SELECT track FROM persons UNION SELECT track FROM sightings) p, keyframes
    JOIN frames f ON f.annotated AND f.frame IN (t - 15, t, t + 15)
    LEFT JOIN sightings s ON s.track = p.track AND s.frame = f.frame
    GROUP BY t, p.track
    HAVING count(*) = 3 AND count(s.frame) = 0;

-- seen: 1 in clear view, 0 absent, null unknown.
CREATE TABLE moments AS
    SELECT t, track, CASE WHEN clear THEN 1 END AS seen, clear, image, ahead, pose, distance, angle FROM people
    UNION ALL
    SELECT t, track, 0, false, image, false, NULL, NULL, NULL FROM absent JOIN pictures ON frame = t;

-- How a distance has changed when somebody is read later; null where nothing can be said.
CREATE MACRO distance_change(before, afterwards, seen) AS
    CASE WHEN before IS NULL THEN NULL WHEN seen = 0 THEN 'not in view'
         WHEN before - afterwards >= changed() THEN 'closer to the robot'
         WHEN afterwards - before >= changed() THEN 'farther from the robot'
         WHEN abs(before - afterwards) < same() THEN 'about the same distance' END;

-- When somebody is present, of two times.
CREATE MACRO present_at(first, second) AS
    CASE (first, second)
        WHEN (1, 1) THEN 'both times' WHEN (1, 0) THEN 'only at the first time'
        WHEN (0, 1) THEN 'only at the second time' WHEN (0, 0) THEN 'neither time' END;
