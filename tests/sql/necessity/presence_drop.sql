SELECT n.t, n.track, two.t - one.t AS spacing, count(*) AS defined,
    count(DISTINCT present_at(one.seen, two.seen)) AS answers
FROM names n
JOIN moments one ON one.track = n.track AND one.t >= n.t + wait() AND one.seen IS NOT NULL
JOIN moments two ON two.track = n.track AND two.t >= one.t + wait() AND two.seen IS NOT NULL
WHERE n.general
GROUP BY n.t, n.track, spacing
