-- Whom companies meet that are long and large enough to be asked about.
WITH lasting AS (
    SELECT m.*, max(k.t) OVER (PARTITION BY m.t, track, label) AS until
    FROM meetings m ASOF JOIN keyframes k ON k.t < m.ends)
SELECT t, track, label, target, met, seen
FROM lasting
QUALIFY until >= t + long_wait()
    AND count(*) FILTER (met <= until) OVER (PARTITION BY t, track, label) >= least_people()
    AND met IS NOT NULL AND least(met, maybe) <= until
