-- With whom people are in a social or group relation over time, as far as it is known.

-- What is said of pairs at the frames between two keyframes.
CREATE TABLE between_keyframes AS
    SELECT a.frame, source, target, label
    FROM spans JOIN labels USING (label)
    JOIN boxes a ON a.track = source AND a.frame BETWEEN first AND last
    JOIN boxes b ON b.track = target AND b.frame = a.frame
    WHERE kind IN ('social', 'group') AND a.frame NOT IN (FROM keyframes)
    GROUP BY ALL;

CREATE TABLE countable AS SELECT DISTINCT label, kind FROM facts WHERE sure AND kind IN ('social', 'group');

-- The first moment from which on a person's partners are no longer known: at a keyframe without a box or with somebody
-- possible; or after a keyframe, when nothing is told of somebody at a frame before the next one.
CREATE TABLE unknown AS
    SELECT t AS frame, track AS source, label
    FROM (SELECT DISTINCT track FROM people) CROSS JOIN keyframes CROSS JOIN countable
    WHERE (t, track) NOT IN (SELECT (t, track) FROM people)
    UNION ALL
    SELECT t, source, label FROM possible WHERE kind IN ('social', 'group') AND NOT sure
    UNION ALL
    SELECT a.frame, a.track, label
    FROM told a JOIN told b ON b.frame = a.frame AND b.kind = a.kind AND b.track <> a.track
    JOIN countable c ON c.kind = a.kind
    WHERE NOT (a.tells AND b.tells) AND a.frame NOT IN (FROM keyframes)
        AND (a.frame, a.track, b.track, label) NOT IN (SELECT (frame, source, target, label) FROM between_keyframes);

CREATE TABLE known AS
    SELECT p.t, p.track, p.clear, p.image, p.ahead, c.label, coalesce(min(u.frame), 1e9) AS ends
    FROM people p CROSS JOIN countable c
    LEFT JOIN unknown u ON u.source = p.track AND u.label = c.label AND u.frame >= p.t
    GROUP BY ALL;

-- Whom each person meets from each keyframe on: when first, when first in clear view both, and when perhaps between
-- two keyframes.
CREATE TABLE meetings AS
    WITH met AS (
        SELECT t AS frame, source, target, label, a.clear AND b.clear AS clear, a.image
        FROM facts JOIN people a USING (t) JOIN people b USING (t)
        WHERE sure AND kind IN ('social', 'group') AND a.track = source AND b.track = target
        UNION ALL
        SELECT frame, source, target, label, NULL, NULL FROM between_keyframes)
    SELECT k.t, k.track, k.label, target, ends,
        min(frame) FILTER (m.clear IS NOT NULL) AS met, min(frame) FILTER (m.clear) AS seen,
        min(frame) FILTER (m.clear IS NULL) AS maybe, arg_min(m.image, frame) FILTER (m.clear) AS image
    FROM known k JOIN met m ON m.source = k.track AND m.label = k.label AND m.frame >= k.t
    GROUP BY k.t, k.track, k.label, target, ends;
