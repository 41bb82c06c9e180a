-- Whom two relations of two people single out together, where each of them alone could hold of two or more.

-- Everybody within some degrees to one side of a person, as the robot sees it; nobody can tell within a degree of the
-- window's edge, or of the person's own direction.
CREATE TABLE windows AS
    WITH pairs AS (
        SELECT a.t, a.track AS source, b.track AS target,
            CASE WHEN b.angle >= a.angle THEN b.angle - a.angle ELSE b.angle - a.angle + 360 END AS turned
        FROM people a JOIN people b ON b.t = a.t AND b.track <> a.track),
    sides AS (
        SELECT *, 'right' AS side FROM pairs
        UNION ALL SELECT * REPLACE (CASE WHEN turned > 0 THEN 360 - turned ELSE 0 END AS turned), 'left' FROM pairs)
    SELECT t, source, target, format('within {} degrees to the {} of (robot view)', degrees, side) AS label,
        turned > 1 AND turned < 359 AND turned < degrees - 1 AS sure
    FROM sides, (VALUES (30), (45), (60), (90)) w(degrees)
    WHERE turned <= degrees + 1 OR turned >= 359;

CREATE TABLE joining AS
    SELECT t, source, target, label, sure FROM possible WHERE kind <> 'robot'
    UNION ALL SELECT * FROM windows;

CREATE TABLE forks AS
    SELECT DISTINCT n.t, n.track AS a, one.target AS b, two.target AS c
    FROM names n
    JOIN hops one ON one.t = n.t AND one.source = n.track
    JOIN hops two ON two.t = n.t AND two.source = n.track AND two.label > one.label AND two.target <> one.target
    WHERE n.general;

CREATE TABLE joined AS
    WITH branches AS (
        SELECT f.*, source, target, label, sure
        FROM forks f JOIN joining j ON j.t = f.t AND j.source IN (f.b, f.c) AND j.target NOT IN (f.a, f.b, f.c)
        QUALIFY count(*) OVER (PARTITION BY f.t, f.a, f.b, f.c, source, label) >= 2)
    SELECT l.t, l.a, l.b, l.c, l.label AS r3, r.label AS r4, any_value(l.target) AS d
    FROM branches l JOIN branches r USING (t, a, b, c, target)
    WHERE l.source = l.b AND r.source = r.c
    GROUP BY l.t, l.a, l.b, l.c, l.label, r.label
    HAVING count(*) = 1 AND bool_and(l.sure AND r.sure);
