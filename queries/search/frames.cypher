// Return which frames of a sequence have boxes annotated, and which are keyframes.
MATCH (f:Frame) WHERE f.sequence = $sequence
RETURN f.frame AS frame, f.annotated AS annotated, f.keyframe AS keyframe ORDER BY frame
