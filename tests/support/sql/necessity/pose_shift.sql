SELECT m.track, m.t, moved.pose AS answer
FROM moments m JOIN moments moved ON moved.track = m.track AND moved.t = m.t + moved_by()
WHERE m.pose IS NOT NULL AND (moved.pose IS NOT NULL OR moved.seen = 0)
