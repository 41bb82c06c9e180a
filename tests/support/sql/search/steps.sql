-- Of everybody by every relation of which anything is known. A relation that holds nowhere for certain leads to nobody.
SELECT t, source, label, coalesce(target, untold())
FROM (SELECT DISTINCT t, source, label FROM facts) LEFT JOIN steps USING (t, source, label)
