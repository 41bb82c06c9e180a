SELECT m.track, m.t, moved.seen
FROM moments m JOIN moments moved ON moved.track = m.track AND moved.t = m.t + moved_by()
WHERE moved.seen IS NOT NULL
