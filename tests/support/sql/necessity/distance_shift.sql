SELECT n.track, n.t, later.t, distance_change(m.distance, moved.distance, moved.seen) AS answer
FROM names n JOIN moments m USING (t, track)
JOIN moments later ON later.track = n.track AND later.t >= n.t + wait()
JOIN moments moved ON moved.track = later.track AND moved.t = later.t + moved_by()
WHERE n.general AND moved.seen IS NOT NULL AND answer IS NOT NULL
