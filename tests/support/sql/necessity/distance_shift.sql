SELECT n.track, n.t, moved.t - moved_by() AS t1, distance_change(m.distance, moved.distance, moved.seen) AS answer
FROM names n JOIN moments m USING (t, track)
JOIN moments moved ON moved.track = n.track AND moved.t >= n.t + wait() + moved_by()
WHERE n.general AND moved.seen IS NOT NULL AND answer IS NOT NULL
