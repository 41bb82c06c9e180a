SELECT m.track, m.t, count(*) AS defined, count(DISTINCT other.pose) AS answers
FROM moments m JOIN moments other ON other.track = m.track AND other.t >= m.t + wait() AND other.pose IS NOT NULL
GROUP BY m.track, m.t
