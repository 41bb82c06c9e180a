"""The wording table against its own inverse, and against what a reader must be told."""

import itertools
import re

import msgspec
import pytest
from environment import examples
from hypothesis import example, given, settings
from hypothesis import strategies as st

from jrdb_avr.schema.errors import PlanError
from jrdb_avr.schema.labels import (
    ACTION_PHRASES,
    ACTIONS,
    AGES,
    DISTANCE_WORDS,
    GENDERS,
    INTERACTION_PHRASES,
    INTERACTIONS,
    OTHER_ACTIONS,
    PERSON_SECTORS,
    POSES,
    ROBOT_SECTORS,
)
from jrdb_avr.schema.plan import AnswerSpec, Condition, Node, Plan, Time, canonical, parse_plan
from jrdb_avr.schema.relations import FIRST_LEFT, FIRST_RIGHT, QUESTION_RELATIONS, SAME_GROUP
from jrdb_avr.schema.templates import FAMILIES, TEMPLATES
from jrdb_avr.schema.things import OBJECTS, VERBS
from jrdb_avr.schema.wording import text as wording
from jrdb_avr.schema.wording.people import describe, in_order, read_description
from jrdb_avr.schema.wording.text import parse, question_id, question_key, render

KEYS = st.text("0123456789abcdef", min_size=64, max_size=64)
FRAMES = st.integers(0, 600_000)

# What a path may be made of, put together here a second time.
NEAR = [f"{sector}, {word}" for sector in PERSON_SECTORS for word in ("very close", "close", "moderate")]
HOPS = [*INTERACTIONS, SAME_GROUP, *NEAR, FIRST_LEFT, FIRST_RIGHT]
WINDOWS_LEFT, WINDOWS_RIGHT = (
    [f"within {n} degrees to the {side} of (robot view)" for n in (30, 45, 60, 90)] for side in ("left", "right")
)
JOINS = [*INTERACTIONS, SAME_GROUP, *NEAR, *WINDOWS_LEFT, *WINDOWS_RIGHT]
COUNTS = [*INTERACTIONS, SAME_GROUP]


def attribute(name, values, timed=True):
    return st.sampled_from(values).map(lambda value: Condition(attribute=name, value=value, at="t0" if timed else None))


CONDITIONS = st.lists(
    st.one_of(
        attribute("gender", list(GENDERS), timed=False),
        attribute("age", list(AGES), timed=False),
        st.sampled_from(ACTIONS).map(lambda action: Condition(action=action, at="t0")),
        st.sampled_from(INTERACTIONS).map(lambda label: Condition(interaction=label, at="t0")),
        st.builds(
            lambda verb, thing: Condition(verb=verb, object=thing, at="t0"), *map(st.sampled_from, [VERBS, OBJECTS])
        ),
        attribute("group_size", [1, 2, 3, 7, 12, 13, 28]),
        attribute("sector", list(ROBOT_SECTORS)),
        attribute("distance", list(DISTANCE_WORDS)),
    ),
    min_size=1,
    max_size=5,
    unique_by=lambda c: c.attribute or c.action or c.interaction or (c.verb, c.object),
).map(in_order)


# -- plans of every template, written out a second time -------------------------------------------------------


def choice(read, of, at):
    return {"mode": "multiple_choice", "read": read, "of": of, "at": at}


def start_of(of, action, after="t0"):
    return {"event": "start", "of": of, "action": action, "after": after}


def seconds(*at):
    return {"mode": "number", "read": "seconds_between", "of": "a", "at": list(at)}


def make_plan(form, conditions, frames, actions=("walking", "typing"), relations=("conversation", FIRST_LEFT)):
    """The plan of a template, or of a form of `gap`; relations edge by edge."""
    first, second = (*actions, None, None)[:2]
    (counted,) = relations[:1] or ("",)
    stated = {f"t{i}": {"frame": frame} for i, frame in enumerate(frames)}
    start = start_of("a", first)
    leaves, returns = ({"event": event, "of": "a", "after": t} for event, t in (("leaves", "t0"), ("returns", "t1")))
    answer, events, path = {
        "change": (choice("action", "a", "t1"), {}, ""),
        "presence": (choice("presence", "a", ["t1", "t2"]), {}, ""),
        "distance": (choice("distance_change", "a", ["t0", "t1"]), {}, ""),
        "start": ({"mode": "frame", "read": "start", "of": "a", "at": "t1"}, {"t1": start}, ""),
        "span": (
            {"mode": "span", "read": "span", "of": "a", "at": ["t1", "t2"]},
            {"t1": start, "t2": {"event": "end", "of": "a", "action": first, "after": "t1"}},
            "",
        ),
        "two_hop": (choice("action", "c", "t0"), {}, "ab bc"),
        "three_hop": (choice("action", "d", "t0"), {}, "ab bc cd"),
        "fork_join": (choice("action", "d", "t0"), {}, "ab ac bd cd"),
        "action_search": (
            {"mode": "frame_viewpoint", "read": "start_view", "of": "c", "at": "t1"},
            {"t1": start_of("c", first)},
            "ab bc",
        ),
        "later_action": (choice("action", "c", "t1"), {}, "ab bc"),
        "consequence": (choice("next_action", "a", "t1"), {"t1": {"event": "end", "of": "a", "after": "t0"}}, ""),
        "gap_starts": (seconds("t1", "t2"), {"t1": start, "t2": start_of("a", second)}, ""),
        "gap_absence": (seconds("t1", "t2"), {"t1": leaves, "t2": returns}, ""),
        "gap_count": (
            {"mode": "number", "read": "count", "of": "a", "at": ["t1", "t2"], "relation": counted},
            {},
            "",
        ),
    }[form]
    told = [msgspec.to_builtins(condition) for condition in conditions]
    at = "t0"
    if form == "gap_count":
        at, stated = "t1", {"t1": {"frame": frames[0]}, "t2": {"frame": frames[1]}}
        told = [condition | {"at": "t1"} if "at" in condition else condition for condition in told]
    edges = [
        {"source": source, "relation": relation, "target": target, "at": at}
        for (source, target), relation in zip(path.split(), relations, strict=False)
    ]
    people = sorted(set("a" + path.replace(" ", "")))
    nodes = [{"id": node, "conditions": told if node == "a" else []} for node in people]
    document = {
        "root": "a",
        "target": answer["of"],
        "times": stated | events,
        "nodes": nodes,
        "edges": edges,
        "answer": answer,
    }
    return parse_plan(msgspec.json.encode(document))


STATED = dict.fromkeys(("start", "span", "two_hop", "three_hop", "fork_join", "action_search", "consequence"), 1)
STATED |= {"gap_starts": 1, "gap_absence": 1}
STATED |= {"change": 2, "distance": 2, "later_action": 2, "gap_count": 2, "presence": 3}
"""How many times each form states as frames."""
HOPS_OF = {"two_hop": 2, "three_hop": 3, "action_search": 2, "later_action": 2}
EVENTS = {"start", "span", "action_search", "gap_starts", "gap_absence"}
"""Templates that ask when something happens."""


def template_of(form):
    return form.partition("_")[0] if form.startswith("gap") else form


def relation_lists(form):
    if form == "fork_join":
        branches = st.lists(st.sampled_from(HOPS), min_size=2, max_size=2, unique=True).map(sorted)
        return st.builds(lambda hops, joins: (*hops, *joins), branches, st.tuples(*[st.sampled_from(JOINS)] * 2))
    if form == "gap_count":
        return st.tuples(st.sampled_from(COUNTS))
    return st.tuples(*[st.sampled_from(HOPS)] * HOPS_OF.get(form, 0))


@st.composite
def plans(draw, *forms):
    form = draw(st.sampled_from(forms or sorted(STATED)))
    frames = draw(st.lists(FRAMES, min_size=STATED[form], max_size=STATED[form], unique=True).map(sorted))
    actions = draw(st.lists(st.sampled_from(ACTIONS), min_size=2, max_size=2, unique=True))
    return form, make_plan(form, draw(CONDITIONS), frames, actions, draw(relation_lists(form)))


# -- the table ------------------------------------------------------------------------------------------------


def test_this_table_holds_the_twelve_templates():
    assert set(TEMPLATES) == set(STATED)
    for name, row in TEMPLATES.items():
        assert row.name == template_of(name) and row.family == FAMILIES[row.name]
        assert len(row.stated) == STATED[name]
        assert len(set(row.paraphrases)) >= 3


def test_every_word_of_the_vocabularies_has_a_phrase_and_no_two_share_one():
    assert set(ACTION_PHRASES) == set(ACTIONS)
    assert set(INTERACTION_PHRASES) == set(INTERACTIONS)
    assert set(QUESTION_RELATIONS) == set(HOPS) | set(JOINS)
    states = [Condition(action=action, at="t0") for action in ACTIONS]
    states += [Condition(interaction=label, at="t0") for label in INTERACTIONS]
    states += [Condition(verb=verb, object=thing, at="t0") for verb in VERBS for thing in OBJECTS]
    states += [Condition(attribute="group_size", value=size, at="t0") for size in range(1, 40)]
    texts = {condition: describe([condition]) for condition in states}
    assert len(set(texts.values())) == len(states) > 6000
    for condition, text in texts.items():
        assert read_description(text, "t0") == (condition,)
        # Lists of phrases are split at these.
        phrase = text.removeprefix("the only person who is ")
        assert " and " not in phrase and "," not in phrase
        # Labels are not English yet.
        assert not re.search(r"[_/]|\bsth\b", phrase)


# -- render and parse -----------------------------------------------------------------------------------------


@settings(max_examples=examples(80), deadline=None)
@given(plans(), KEYS, st.booleans(), st.booleans())
def test_parse_is_the_inverse_of_render(case, key, about, in_view):
    form, plan = case
    text = render(template_of(form), plan, key, about, in_view)
    found, back = parse(text)
    assert found == template_of(form)
    assert canonical(back) == canonical(plan)


IN_VIEW = " Only people in clear view count (at least half of the person can be seen)."


@settings(max_examples=examples(60), deadline=None)
@given(plans(), KEYS, st.booleans())
def test_a_question_says_once_that_only_people_in_clear_view_count(case, key, about):
    form, plan = case
    plain, text = (render(template_of(form), plan, key, about, in_view) for in_view in (False, True))
    assert text.endswith(IN_VIEW) and text.count(IN_VIEW) == 1 and "in the picture" not in text
    sized = any(condition.attribute == "group_size" for node in plan.nodes for condition in node.conditions)
    grouped = any(edge.relation == SAME_GROUP and "in the picture" in plain for edge in plan.edges)
    changed = sized or grouped or form == "gap_count"
    assert (text.removesuffix(IN_VIEW) != plain) == changed
    assert text.count("in clear view at that moment") == (form == "gap_count")
    for broken in (text + IN_VIEW, plain + IN_VIEW if changed else plain + IN_VIEW[:-1], text.removesuffix(IN_VIEW)):
        if broken != plain:
            with pytest.raises(PlanError):
                parse(broken)


@settings(max_examples=examples(40), deadline=None)
@given(plans(), KEYS, st.booleans())
def test_questions_with_actions_as_choices_say_that_one_is_true(case, key, in_view):
    form, plan = case
    text = render(template_of(form), plan, key, in_view=in_view)
    asked = TEMPLATES[form].asks_action
    assert asked == (form in {"change", "two_hop", "three_hop", "fork_join", "later_action", "consequence"})
    words = r"hich of these is (C|D|that person|this person) doing|hich of these does (that|the) person do (next|first)"
    assert (text.count(" Only one is true."), bool(re.search(words, text))) == (asked, asked)
    assert "movement" not in text


def every_text(form):
    """{plan: text} of a form, each place of its text varied alone over all that may stand there, per paraphrase."""
    relations = {"gap_count": (COUNTS,), "fork_join": (HOPS, HOPS, JOINS, JOINS)}.get(
        form, (HOPS,) * HOPS_OF.get(form, 0)
    )
    usual = {"fork_join": ("conversation", SAME_GROUP, NEAR[0], JOINS[-1]), "gap_count": ("conversation",)}.get(
        form, ("conversation", FIRST_LEFT, SAME_GROUP)[: len(relations)]
    )
    frames, sitting = [150, 300, 450][: STATED[form]], [Condition(action="sitting", at="t0")]
    cases = [(sitting, frames, ("walking", "typing"), usual)]
    for i, relation in ((i, relation) for i, known in enumerate(relations) for relation in known):
        told = (*usual[:i], relation, *usual[i + 1 :])
        if form != "fork_join" or told[0] < told[1]:
            cases.append((sitting, frames, ("walking", "typing"), told))
    if TEMPLATES[form].actions:
        pairs = [(a, "lying") for a in ACTIONS if a != "lying"] + [("lying", a) for a in ACTIONS if a != "lying"]
        cases += [(sitting, frames, pair, usual) for pair in pairs]
    for action in ACTIONS:
        cases.append(([Condition(action=action, at="t0")], frames, ("walking", "typing"), usual))
    for i in range(len(frames)):
        moved = [frame + 1 if j == i else frame for j, frame in enumerate(frames)]
        cases.append((sitting, moved, ("walking", "typing"), usual))
    made = {canonical(plan): plan for plan in itertools.starmap(lambda *case: make_plan(form, *case), cases)}
    for paraphrase in range(len(TEMPLATES[form].paraphrases)):
        yield {text: render(template_of(form), plan, f"{paraphrase:064x}") for text, plan in made.items()}


@pytest.mark.parametrize("form", STATED)
def test_no_two_plans_share_a_text_and_each_is_read_back(form):
    seen = set()
    for texts in every_text(form):
        assert len(texts) > 25
        assert len(set(texts.values())) == len(texts)
        assert not seen & set(texts.values())
        seen |= set(texts.values())
        for plan, text in texts.items():
            template, back = parse(text)
            assert (template, canonical(back)) == (template_of(form), plan)


OWN = r"\b([A-D]|that person)'s (?:front |back )?(?:left|right)\b"
ROBOTS = r"\bto the robot's (?:left|right)\b"
SEEN = r"\bto the (?:left|right) of [A-D] as seen from the robot\b"


@settings(max_examples=examples(60))
@given(plans(), KEYS)
def test_left_and_right_say_whose(case, key):
    form, plan = case
    text = render(template_of(form), plan, key)
    rest = re.sub("|".join((OWN, ROBOTS, SEEN)), "", text)
    if re.search(SEEN, text):
        rest = rest.removesuffix(" For left and right, go by the middle of each person.")
    assert not re.search(r"\b(left|right)(ward|most)?\b", rest)
    # A place in somebody's own frame, also in front and behind, is followed by whose eyes it is seen with.
    own = [edge for edge in plan.edges if ", " in edge.relation]
    assert text.count("'s own point of view") == len(own)
    for edge in own:
        sector = edge.relation.partition(",")[0]
        x = edge.source.upper()
        place = {"front": f"in front of {x}", "back": f"behind {x}"}.get(sector, f"to {x}'s {sector}")
        assert re.search(rf"{place},? \(?from {x}'s own point of view\b", text)
    for edge in plan.edges:
        side = re.search(r"\b(left|right) of \(robot view\)", edge.relation)
        assert not side or f"to the {side[1]} of {edge.source.upper()}" in text
    for word in ("next to", "beside", "adjacent"):
        assert word not in text


@settings(max_examples=examples(25))
@given(plans(), KEYS)
def test_about_is_said_of_events_only(case, key):
    form, plan = case
    exact, rough = (render(template_of(form), plan, key, about) for about in (False, True))
    if form in EVENTS:
        assert exact != rough and "about " in rough.lower() and "about" not in exact.lower()
    else:
        assert exact == rough


@settings(max_examples=examples(25))
@given(plans("action_search"), KEYS, st.booleans())
def test_viewpoints_say_what_the_angles_mean(case, key, about):
    text = render(*case, key, about)
    for angle, meaning in (
        (0, "behind the robot"),
        (90, "the robot's left"),
        (180, "ahead"),
        (270, "the robot's right"),
    ):
        assert re.search(rf"\b{angle} is [a-z ]*{meaning}", text)


@settings(max_examples=examples(60))
@given(plans(), KEYS, st.data())
def test_an_altered_question_is_refused_or_says_something_else(case, key, data):
    form, plan = case
    text = render(template_of(form), plan, key)
    place = data.draw(st.integers(0, len(text) - 1))
    letter = data.draw(st.sampled_from("x9 ,.A\n"))
    altered = text[:place] + letter + text[place + 1 :]
    try:
        found, back = parse(altered)
    except PlanError:
        return
    assert altered == text or (found, canonical(back)) != (template_of(form), canonical(plan))


QUESTION = (
    "Find the only person who is walking at {}. Which of these is that person doing at 15.0 s (frame 225)? Only one is "
    "true."
)
HOPPED = (
    "In the scene at 10.0 s (frame 150), A is the only {}. {} is having a conversation with exactly one person, "
    "B. B and C are the only two members of their group in the picture. Which of these is C doing? Only one is true."
)


@given(st.text(max_size=300))
@example("")
@example("Find the only person who is walking at 10.0 s (frame 150).")
@example(QUESTION.format("10.1 s (frame 150)"))
@example(QUESTION.format("10.0 s (frame 0150)"))
@example(QUESTION.format("10.0 s (frame 1\u06650)"))
@example(HOPPED.format("child", "B"))
@example(HOPPED.format("child who is", "A"))
@example(HOPPED.format("child", "a"))
def test_another_text_is_refused(text):
    with pytest.raises(PlanError):
        parse(text)


def test_what_the_refused_texts_are_near_to_is_a_question():
    assert parse(QUESTION.format("10.0 s (frame 150)"))[0] == "change"
    assert parse(HOPPED.format("child", "A"))[0] == "two_hop"


# -- how it reads ---------------------------------------------------------------------------------------------

DESCRIPTIONS = {
    "the only person far from the robot (5 to 10 m) who is sitting": [
        {"action": "sitting"},
        {"attribute": "distance", "value": "far"},
    ],
    "the only person to the robot's left and close to it (0.5 to 1.5 m) who is in a group of three in the picture": [
        {"attribute": "group_size", "value": 3},
        {"attribute": "sector", "value": "left"},
        {"attribute": "distance", "value": "close"},
    ],
    "the only person behind the robot who is walking, holding something and in no group in the picture": [
        {"action": "walking"},
        {"action": "holding sth"},
        {"attribute": "group_size", "value": 1},
        {"attribute": "sector", "value": "behind"},
    ],
    "the only person who is walking and carrying a bag": [{"action": "walking"}, {"verb": "carrying", "object": "bag"}],
    "the only person who is putting something into a trash bin": [{"verb": "putting_something", "object": "trash_bin"}],
    "the only person who is handling a phone and hugging someone": [
        {"verb": "handling/manipulating", "object": "phone"},
        {"interaction": "hugging"},
    ],
}


@pytest.mark.parametrize(("text", "conditions"), DESCRIPTIONS.items())
def test_descriptions_read_so(text, conditions):
    assert describe([Condition(**condition, at="t0") for condition in conditions]) == text


SITTING = Condition(action="sitting", at="t0")
READ = {
    ("start", 0, ()): (
        "Find the only person who is sitting at 10.0 s (frame 150). "
        "At about which frame does that person start looking at the robot for the first time after that?"
    ),
    ("fork_join", 0, ("hugging", SAME_GROUP, WINDOWS_LEFT[1], "back, moderate")): (
        "Find the only person who is sitting at 10.0 s (frame 150); call that person A. At that moment, A is hugging "
        "exactly one person, B. A and C are the only two members of their group in the picture. Leaving A, B and C "
        "aside, D is the only person who is within 45 degrees to the left of B as seen from the robot and who is "
        "also at a moderate distance from C (1.5 to 5 m) and behind C (from C's own point of view). Which of these is "
        "D doing then? Only one is true. For left and right, go by the middle of each person."
    ),
    ("action_search", 1, (FIRST_RIGHT, "sitting together")): (
        "In the scene at 10.0 s (frame 150), A is the only person who is sitting. B is the first person to the right "
        "of A as seen from the robot. B is sitting together with exactly one person, C. About when does C first start "
        "looking at the robot after that moment, and in which direction from the robot is C then? Give the frame and "
        "the panorama angle. Panorama angles are in degrees: 0 is behind the robot, 90 is to the robot's left, 180 is "
        "straight ahead of the robot and 270 is to the robot's right. For left and right, go by the middle of each "
        "person."
    ),
    ("gap_count", 0, (SAME_GROUP,)): (
        "Find the only person who is sitting at 10.0 s (frame 150). From then until 20.0 s (frame 300), how many other "
        "people are, at one moment or another, in the same group as that person?"
    ),
}


@pytest.mark.parametrize("case", READ, ids=lambda case: case[0])
def test_questions_read_so(case):
    form, paraphrase, relations = case
    frames = [150, 300][: STATED[form]]
    plan = make_plan(form, [SITTING], frames, ("looking at robot", "typing"), relations)
    assert render(template_of(form), plan, f"{paraphrase:064x}", about=True) == READ[case]


def test_a_long_text_is_refused_soon():
    for text in ("Find the only person" + " at " * 900, "Find " + "the only person at 1.0 s (frame 15)" * 110):
        with pytest.raises(PlanError):
            parse(text + ". Which of these is that person doing at 15.0 s (frame 225)? Only one is true.")
    many = in_order([Condition(action=action, at="t0") for action in ACTIONS] * 10)
    with pytest.raises(PlanError, match=r"too many|length <= 8"):
        render("change", make_plan("change", many, [0, 225]), "0" * 64)
    with pytest.raises(PlanError):
        parse(QUESTION.format("10.0 s (frame 150)") * 1000)


# -- refusals -------------------------------------------------------------------------------------------------


def test_render_refuses_what_it_cannot_say():
    sitting, far = SITTING, Condition(attribute="distance", value="far", at="t0")
    change = make_plan("change", [sitting, far], [150, 225])
    two_hop = make_plan("two_hop", [sitting], [150])

    def plan_of(**condition):
        return "change", make_plan("change", [Condition(**condition)], [0, 225])

    cases = [
        ("no template", "nothing", change),
        ("no template", "gap_starts", make_plan("gap_starts", [sitting], [150])),
        ("no plan of the template", "presence", change),
        ("no plan of the template", "start", make_plan("change", [sitting], [150, 225])),
        ("no plan of the template", "start", make_plan("span", [sitting], [150])),
        ("no plan of the template", "gap", make_plan("start", [sitting], [150])),
        ("no plan of the template", "three_hop", two_hop),
        ("no plan of the template", "later_action", two_hop),
        ("no plan of the template", "change", two_hop),
        ("in_order", "change", make_plan("change", [far, sitting], [150, 225])),
        ("no words for the action", *plan_of(action="juggling", at="t0")),
        ("no words for the place", *plan_of(attribute="sector", value="above", at="t0")),
        ("no words for the object", *plan_of(object="cannon", verb="carrying", at="t0")),
        ("no words for the verb", *plan_of(object="bag", verb="eating", at="t0")),
        ("no words for other", *plan_of(attribute="gender", value="other")),
        ("is no size", *plan_of(attribute="group_size", value=0, at="t0")),
        ("given twice", "change", make_plan("change", [far, far], [0, 225])),
        ("different ones", "gap", make_plan("gap_starts", [sitting], [0], ("walking", "walking"))),
        ("no words for the relation 'r'", "two_hop", make_plan("two_hop", [sitting], [0], (), ("r", "hugging"))),
        ("no words for .* as a count", "gap", make_plan("gap_count", [sitting], [0, 9], (), (FIRST_LEFT,))),
        ("no words for", "two_hop", make_plan("two_hop", [sitting], [0], (), ("left, far", "hugging"))),
        # A window holds several people, so it is no hop; the first to the left is one, so it joins nothing.
        ("as a hop", "two_hop", make_plan("two_hop", [sitting], [0], (), ("hugging", WINDOWS_LEFT[0]))),
        *(
            (message, "fork_join", make_plan("fork_join", [sitting], [0], (), relations))
            for message, relations in (
                ("as a join", ("conversation", "hugging", SAME_GROUP, FIRST_LEFT)),
                (r"edges\[1\].relation", ("hugging", "hugging", SAME_GROUP, SAME_GROUP)),
                (r"edges\[0\].relation", ("hugging", "conversation", SAME_GROUP, SAME_GROUP)),
            )
        ),
    ]
    for message, template, plan in cases:
        with pytest.raises(PlanError, match=message):
            render(template, plan, "0" * 64)


def test_a_plan_of_another_shape_is_refused():
    plan = Plan(
        root="b",
        target="b",
        times={"t0": Time(frame=0), "t1": Time(frame=60)},
        nodes=(Node(id="b", conditions=(Condition(action="sitting", at="t0"),)),),
        edges=(),
        answer=AnswerSpec(mode="multiple_choice", read="action", of="b", at="t1"),
    )
    with pytest.raises(PlanError, match="no plan of the template"):
        render("change", plan, "0" * 64)
    # A condition at another time than that of the description would not be heard in the text.
    late = make_plan("change", [Condition(action="sitting", at="t1")], [150, 225])
    with pytest.raises(PlanError, match=r"nodes\[0\]"):
        render("change", late, "0" * 64)


# -- identity -------------------------------------------------------------------------------------------------


def test_identities_change_with_every_part():
    plan = make_plan("change", [Condition(action="sitting", at="t0")], [150, 225])
    other = make_plan("change", [Condition(action="sitting", at="t0")], [150, 240])
    keys = {
        question_key("s", 1, plan),
        question_key("s", 2, plan),
        question_key("r", 1, plan),
        question_key("s", 1, other),
    }
    assert len(keys) == 4 and all(len(key) == 64 for key in keys)
    base = ("s", "f", "t", "q", ["a", "b"], "multiple_choice")
    ids = {question_id(*base)}
    for i, value in enumerate(("x", "x", "x", "x", ["b", "a"], "x")):
        ids.add(question_id(*base[:i], value, *base[i + 1 :]))
    assert len(ids) == 7 and all(len(value) == 16 for value in ids)


def test_stated_frames():
    sitting = (Condition(action="sitting", at="t0"),)
    plan = make_plan("start", sitting, [150], ["typing"])
    assert wording.implied_choices(sitting, ("typing",)) >= {"sitting", "typing"}
    assert wording.stated_frames(plan) == (150,)
    riding = (Condition(verb="riding", object="bicycle/scooter", at="t0"),)
    implied = wording.implied_choices(riding, ("walking together", "conversation"))
    assert implied >= {"cycling", "scootering", "skating", "walking", "talking to someone"}
    assert set(POSES).isdisjoint(OTHER_ACTIONS)


POSE_WORDS = {
    "walking": "walking|walks",
    "standing": "standing",
    "sitting": "sitting",
    "cycling": "cycling|riding a bicycle",
    "going upstairs": "upstairs|going up|climbing",
    "going downstairs": "downstairs|going down",
    "bending": "bending",
    "skating": "skating|riding a skateboard",
    "scootering": "riding a (bicycle or )?scooter",
    "running": "running",
    "lying": "lying",
}


@settings(max_examples=examples(25))
@given(plans(), KEYS)
def test_a_pose_that_the_text_names_is_among_the_implied_actions(case, key):
    form, plan = case
    text = render(template_of(form), plan, key)
    named = {pose for pose, words in POSE_WORDS.items() if re.search(rf"\b({words})\b", text)}
    slots = TEMPLATES[form].slots(plan)
    assert named <= wording.implied_choices(slots.conditions, (*slots.relations, *slots.actions))
