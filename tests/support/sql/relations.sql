-- Relations between two people with a box at a keyframe: certain, possible, and the steps that lead to one person.

CREATE TABLE labels AS
    SELECT word AS label, 'social' AS kind FROM vocabulary WHERE list = 'interaction'
    UNION ALL SELECT 'in the same group as', 'group'
    UNION ALL SELECT 'first to the ' || side || ' of (robot view)', 'robot' FROM (VALUES ('left'), ('right')) s(side)
    UNION ALL SELECT sector || ', ' || word, 'place'
        FROM (VALUES ('front'), ('front left'), ('left'), ('back left'), ('back'), ('back right'), ('right'),
            ('front right')) s(sector), (VALUES ('very close'), ('close'), ('moderate')) w(word);

-- Whether a person's box says who the partners are, by kind of relation; robot views are seen from every box.
CREATE TABLE told AS
    SELECT frame, track, kind, tells FROM (
        SELECT frame, track, interactions_listed AS social, located AS place, true AS robot,
            EXISTS (FROM memberships m WHERE m.track = b.track AND b.frame BETWEEN first AND last) AS "group"
        FROM boxes b) UNPIVOT (tells FOR kind IN (social, place, robot, "group"));

CREATE TABLE spans AS
    SELECT source, target, label, first, last, certain FROM interactions
    UNION ALL SELECT source, target, label, first, last, certain FROM beside
    UNION ALL SELECT a.track, b.track, 'in the same group as', greatest(a.first, b.first), least(a.last, b.last),
            a.certain AND b.certain
        FROM memberships a JOIN memberships b ON a.cluster = b.cluster AND a.track <> b.track
            AND a.first <= b.last AND b.first <= a.last;

CREATE TABLE facts AS
    SELECT a.t, source, target, label, kind, bool_or(certain) AS sure
    FROM spans JOIN labels USING (label)
    JOIN people a ON a.track = source AND a.t BETWEEN first AND last
    JOIN people b ON b.track = target AND b.t = a.t
    GROUP BY ALL;

-- Every pair that is or could be in a relation; of two people of whom one does not tell, nothing can be ruled out.
-- Relations that are certain nowhere lead nobody anywhere.
CREATE TABLE possible AS
    SELECT a.frame AS t, a.track AS source, b.track AS target, l.label, l.kind, coalesce(sure, false) AS sure
    FROM told a JOIN keyframes ON t = a.frame
    JOIN told b ON b.frame = a.frame AND b.kind = a.kind AND b.track <> a.track
    JOIN labels l ON l.kind = a.kind AND label IN (SELECT label FROM facts WHERE sure)
    LEFT JOIN facts f ON f.t = a.frame AND f.source = a.track AND f.target = b.track AND f.label = l.label
    WHERE sure IS NOT NULL OR NOT (a.tells AND b.tells);

-- Where a relation leads from a person: to the only one who could have it and certainly does; else to nobody, for one
-- of three reasons, which are no tracks.
CREATE MACRO nobody() AS -1;
CREATE MACRO several() AS -2;
CREATE MACRO untold() AS -3;
CREATE MACRO led_to(could, certain, target) AS
    CASE WHEN could = 1 AND certain = 1 THEN target WHEN certain >= 2 THEN several()
         WHEN could = 0 THEN nobody() ELSE untold() END;

CREATE TABLE steps AS
    SELECT p.t, p.track AS source, l.label,
        led_to(count(f.target), count(*) FILTER (f.sure), any_value(f.target)) AS target
    FROM people p CROSS JOIN (SELECT DISTINCT label FROM possible) l
    LEFT JOIN possible f ON f.t = p.t AND f.source = p.track AND f.label = l.label
    GROUP BY p.t, p.track, l.label;

-- Steps that lead to somebody.
CREATE VIEW hops AS FROM steps WHERE target >= 0;

-- What a program reads of the one person it ends at, or why there is none; unknown is a pose that is null.
CREATE MACRO read_of(target, pose) AS
    CASE WHEN target = nobody() THEN 'empty' WHEN target = several() THEN 'ambiguous' ELSE coalesce(pose, 'unknown') END;
CREATE MACRO read_later(seen, pose) AS CASE WHEN seen = 0 THEN 'empty' ELSE coalesce(pose, 'unknown') END;
CREATE MACRO apart(target, start) AS CASE WHEN target = start THEN nobody() ELSE target END;

-- Whether it is certain that a reading is not the answer.
CREATE MACRO another(reading, answer) AS reading NOT IN ('unknown', answer);
