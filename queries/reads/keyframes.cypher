// The sequences of the keyframe layer, and the rules of the layer.
MATCH (k:Keyframes)
RETURN k.sequence AS sequence, k.rules_hash AS rules_hash, k.rules AS rules
ORDER BY sequence
