// What is believed of somebody: sightings, which have no name, and attributes.
UNWIND $plans AS q
WITH beliefs, q.id AS id, q.who AS who
UNWIND beliefs AS b
WITH id, who, b
WHERE b.id = who AND b.other = ''
RETURN id, b.name AS name, b.value AS value, b.number AS number, b.first AS first, b.last AS last
ORDER BY id, name, first, last, value, number
