-- The descriptions of everybody at every keyframe: the fewest conditions that are true of the person while each other
-- person with a box there is false on one of them.

-- Ages that lie side by side have no bound that can be seen.
CREATE MACRO years(word) AS list_position(
    ['childhood', 'adolescence', 'young adulthood', 'middle adulthood', 'late adulthood'], word);

-- Degrees between a box and the axis of a direction as the robot sees it; the panorama's middle is straight ahead.
CREATE MACRO off_axis(angle, word) AS
    180 - abs(abs(angle - CASE word WHEN 'ahead' THEN 180 WHEN 'right' THEN 270 WHEN 'left' THEN 90 ELSE 0 END) - 180);

CREATE TABLE doing AS
    SELECT t, track, action, bool_or(certain) AS sure FROM actions JOIN keyframes ON t BETWEEN first AND last
    GROUP BY ALL;

CREATE TABLE handling AS
    SELECT t, track, verb, word AS category, bool_or(certain) AS sure
    FROM handles JOIN keyframes ON t BETWEEN first AND last
    LEFT JOIN objects USING (object, category_id)
    LEFT JOIN vocabulary ON list = 'thing' AND word = category
    GROUP BY ALL;

-- Nobody's partners in social relations are untold.
CREATE TABLE all_told AS
    SELECT t, count(*) = 1 OR bool_and(interactions_listed) AS told FROM people GROUP BY t;

-- Everything that might be said of people: true, false, or null where it is unknown. usable: for this person at all.
CREATE TABLE said AS
    SELECT t, track, 'gender' AS kind, format('{{"attribute":"gender","value":"{}"}}', word) AS text, word,
        gender = word AS holds, NOT list_contains(layers, 'pose') OR coalesce(face_visible, false) AS usable
    FROM people LEFT JOIN persons USING (track), vocabulary, sequence WHERE list = 'gender'
    UNION ALL
    SELECT t, track, 'age', format('{{"attribute":"age","value":"{}"}}', word), word,
        CASE WHEN age = word THEN true WHEN abs(years(age) - years(word)) > 1 THEN false END,
        NOT list_contains(layers, 'pose') OR coalesce(face_visible, false)
    FROM people LEFT JOIN persons USING (track), vocabulary, sequence WHERE list = 'age'
    UNION ALL
    SELECT t, track, 'pose', format('{{"action":"{}","at":"t0"}}', word), word,
        CASE WHEN pose = word THEN true
             WHEN pose <> word AND (t, track, word) NOT IN (SELECT (t, track, action) FROM doing) THEN false END, true
    FROM people, vocabulary WHERE list = 'pose'
    UNION ALL
    SELECT p.t, p.track, 'action', format('{{"action":"{}","at":"t0"}}', word), word,
        CASE WHEN sure THEN true WHEN sure IS NULL AND listed THEN false END, true
    FROM people p JOIN vocabulary ON list = 'action'
    LEFT JOIN doing d ON d.t = p.t AND d.track = p.track AND d.action = word
    UNION ALL
    SELECT p.t, p.track, 'object', format('{{"at":"t0","object":"{}","verb":"{}"}}', w.category, w.verb), w.verb,
        CASE WHEN bool_or(d.sure AND d.category = w.category) THEN true
             WHEN count(d.t) = 0 AND any_value(handles_listed) THEN false END, true
    FROM people p CROSS JOIN (
        SELECT DISTINCT verb, category FROM handling
        WHERE verb IN (SELECT word FROM vocabulary WHERE list = 'verb')
            AND category NOT IN (SELECT word FROM vocabulary WHERE list = 'person category')
            AND verb NOT IN (SELECT word FROM vocabulary WHERE list = 'pose')) w
    LEFT JOIN handling d ON d.t = p.t AND d.track = p.track AND d.verb = w.verb
        AND (d.category = w.category OR d.category IS NULL)
    GROUP BY p.t, p.track, w.verb, w.category
    UNION ALL
    SELECT p.t, p.track, 'interaction', format('{{"at":"t0","interaction":"{}"}}', word), word,
        CASE WHEN bool_or(f.sure) THEN true WHEN count(f.t) = 0 AND any_value(told) THEN false END, true
    FROM people p JOIN vocabulary ON list = 'interaction' JOIN all_told a ON a.t = p.t
    LEFT JOIN facts f ON f.t = p.t AND f.source = p.track AND f.label = word
    GROUP BY p.t, p.track, word
    UNION ALL
    SELECT t, track, 'group_size', format('{{"at":"t0","attribute":"group_size","value":{}}}', n), n::VARCHAR,
        group_size = n, true
    FROM people, (SELECT DISTINCT group_size AS n FROM people WHERE group_size IS NOT NULL)
    UNION ALL
    SELECT t, track, 'sector', format('{{"at":"t0","attribute":"sector","value":"{}"}}', word), word,
        CASE WHEN off_axis(angle, word) <= 40 THEN true WHEN off_axis(angle, word) > 90 THEN false END, true
    FROM people, vocabulary WHERE list = 'sector'
    UNION ALL
    SELECT t, track, 'distance', format('{{"at":"t0","attribute":"distance","value":"{}"}}', word), word,
        CASE WHEN distance_word = word AND distance_word_other IS NULL THEN true
             WHEN distance_word <> word AND distance_word_other IS DISTINCT FROM word THEN false END, true
    FROM people, vocabulary WHERE list = 'distance';

CREATE TABLE kinds AS
    SELECT * FROM (VALUES ('gender', 1), ('age', 2), ('pose', 3), ('action', 4), ('object', 5), ('interaction', 6),
        ('group_size', 7), ('sector', 8), ('distance', 9)) k(kind, rank);

-- People of a keyframe as the bits of a number, by their slot.
CREATE MACRO seat(slot) AS 1::HUGEINT << slot::INTEGER;
CREATE TABLE crowds AS SELECT t, bit_or(seat(slot)) AS crowd FROM people GROUP BY t;

-- What may be said of a person, whom it excludes, and whether it names a pose.
CREATE TABLE held AS
    SELECT t, track, slot, crowd, rank, text, excluded, kind IN ('sector', 'distance') AS weak,
        kind = 'pose' OR (kind, word) IN (SELECT (list, word) FROM names_pose) AS posed,
        row_number() OVER (PARTITION BY t, track ORDER BY rank, text) AS place
    FROM said JOIN kinds USING (kind) JOIN people USING (t, track) JOIN crowds USING (t) JOIN (
        SELECT t, text, coalesce(bit_or(seat(slot)) FILTER (NOT holds), 0) AS excluded
        FROM said JOIN people USING (t, track) GROUP BY t, text) USING (t, text)
    WHERE holds AND usable;

-- Sets that describe: everybody else is excluded. left_over: how many could match, at the least, if one were dropped.
CREATE TABLE describing AS
    SELECT a.t, a.track, a.posed, [a.rank] AS ranks, [a.text] AS texts, bit_count(a.crowd) AS left_over
    FROM held a
    WHERE NOT a.weak AND a.excluded | seat(a.slot) = a.crowd
    UNION ALL
    SELECT a.t, a.track, a.posed OR b.posed, [a.rank, b.rank], [a.text, b.text],
        least(bit_count(a.crowd & ~a.excluded), bit_count(a.crowd & ~b.excluded))
    FROM held a JOIN held b ON b.t = a.t AND b.track = a.track AND b.place > a.place
    WHERE NOT (a.weak AND b.weak) AND a.excluded | b.excluded | seat(a.slot) = a.crowd
    UNION ALL
    SELECT a.t, a.track, a.posed OR b.posed OR c.posed, [a.rank, b.rank, c.rank], [a.text, b.text, c.text],
        least(bit_count(a.crowd & ~(a.excluded | b.excluded)), bit_count(a.crowd & ~(a.excluded | c.excluded)),
            bit_count(a.crowd & ~(b.excluded | c.excluded)))
    FROM held a JOIN held b ON b.t = a.t AND b.track = a.track AND b.place > a.place
    JOIN held c ON c.t = a.t AND c.track = a.track AND c.place > b.place
    WHERE NOT (a.weak AND b.weak AND c.weak) AND a.excluded | b.excluded | c.excluded | seat(a.slot) = a.crowd;

-- The one chosen of each person at each keyframe, and the one chosen among those that name no pose: the shortest, then
-- by the order of kinds, then by hash.
CREATE TABLE names AS
    WITH texts AS (
        SELECT *, array_to_string(texts, ',') AS text, sha256(concat_ws(chr(10), sequence, track, t, text)) AS hash
        FROM describing, sequence),
    chosen AS (
        SELECT *, true AS general, false AS poseless FROM texts
        QUALIFY row_number() OVER (PARTITION BY t, track ORDER BY len(ranks), ranks, hash) = 1
        UNION ALL
        SELECT *, false, true FROM texts WHERE NOT posed
        QUALIFY row_number() OVER (PARTITION BY t, track ORDER BY len(ranks), ranks, hash) = 1)
    SELECT t, track, text, any_value(texts) AS texts, any_value(left_over) >= 2 AS anchor,
        bool_or(general) AS general, bool_or(poseless) AS poseless
    FROM chosen GROUP BY t, track, text;

-- Whom each description fits at each keyframe: only one person could match and certainly does.
CREATE TABLE fits AS
    WITH members AS (SELECT DISTINCT text, unnest(texts) AS said FROM names),
    each_person AS (
        SELECT m.text, t, track, bool_and(holds IS NOT FALSE) AS could, bool_and(holds IS TRUE) AS certain
        FROM members m JOIN said s ON s.text = m.said GROUP BY m.text, t, track)
    SELECT n.text, k.t,
        led_to(count(*) FILTER (could), count(*) FILTER (certain), any_value(track) FILTER (certain)) AS track
    FROM (SELECT DISTINCT text FROM names) n CROSS JOIN keyframes k
    LEFT JOIN each_person e ON e.text = n.text AND e.t = k.t
    GROUP BY n.text, k.t;
