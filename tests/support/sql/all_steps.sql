-- Where every relation that leads somebody anywhere leads from everybody.
SELECT t, source, label, CASE WHEN target >= 0 THEN 'defined' ELSE read_of(target, NULL) END,
    CASE WHEN target >= 0 THEN target END
FROM steps WHERE label IN (SELECT label FROM hops)
