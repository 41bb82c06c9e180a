SELECT track, one.t, two.t, present_at(one.seen, two.seen) AS answer, one.image AND two.image AS image,
    -- Where the person is in view at neither time, there is no box to look at.
    CASE WHEN one.seen = 1 OR two.seen = 1 THEN (one.ahead OR one.seen = 0) AND (two.ahead OR two.seen = 0) END AS ahead
FROM moments one JOIN moments two USING (track)
WHERE one.seen IS NOT NULL AND two.seen IS NOT NULL AND two.t >= one.t + wait()
