SELECT one.t, one.track, two.t, two.track, present_at(first.seen, second.seen) AS answer
FROM moments one JOIN moments two ON two.track = one.track AND two.t >= one.t + wait()
JOIN moments first ON first.track = one.track AND first.t = one.t + moved_by()
JOIN moments second ON second.track = two.track AND second.t = two.t + moved_by()
WHERE one.seen IS NOT NULL AND two.seen IS NOT NULL AND answer IS NOT NULL
