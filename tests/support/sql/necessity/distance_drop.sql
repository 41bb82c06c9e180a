SELECT track, t, count(*) AS defined, count(DISTINCT answer) AS answers
FROM (
    SELECT n.t, n.track, distance_change(m.distance, other.distance, other.seen) AS answer
    FROM names n JOIN moments m USING (t, track)
    JOIN moments other ON other.track = n.track AND other.t >= n.t + wait()
    WHERE n.general AND other.seen IS NOT NULL AND answer IS NOT NULL)
GROUP BY t, track
