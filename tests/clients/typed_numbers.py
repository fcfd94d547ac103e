"""Types wrong numbers into every number field of the workbench, and asserts that each document of a robot says the same of it.

    pip install playwright axe-playwright-python
    python tests/clients/typed_numbers.py target/debug/dbbd OUT [PART ..]

Parts, all without a name:

    numbers  each number field of each step takes each text of WRONG: nothing is written, and a message beside the field says why
    files    what is saved by the page changes the keys that were typed, and no other byte of the job
    people   two people, two tabs, and roles: of two who save the second one is told (E1512), and nobody does more than the role allows
    fresh    the demo on a service without a port, reloaded at its HALT: its run is simulated
    restart  the service is killed in a run: the page says that the run was cut off, and nothing is decided from it
    states   checks that pass, fail, decide nothing and have no tolerance: page, reports, certificate and `dbbd info` agree
    beside   the demo runs beside a bar that this script plays over TCP: only the demo is called simulated

axe looks at each view. Screenshots go to OUT. Ends with an error at the first assertion that does not hold.
"""

import hashlib
import json
import pathlib
import re
import shutil
import socket
import subprocess
import sys
import threading
import time
import tomllib

from browser import AXE, CHROMIUM, expect, serve, sync_playwright

DBBD, OUT = pathlib.Path(sys.argv[1]).resolve(), pathlib.Path(sys.argv[2]).resolve()
ROOT = pathlib.Path(__file__).parents[2]
TEXTS = {file.stem: json.loads(file.read_text()) for file in (ROOT / "src/live/page/texts").glob("??.json")}
LOCALES = {"en": "en-GB", "de": "de-DE"}
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
# No field takes one of these: no number, a number of another alphabet, one too large, units that do not fit, two ways to read it.
NEVER = ["abc", "1e999", "１２", "0.5 kg", "0.5 in", "1,234.5", "1.234,5", "NaN", "--3", "5 5 5"]
# A field may take these; then the file has exactly this number.
PERHAPS = {"0.5 mm": {"mm": 0.5, "µm": 500}, "0,5": 0.5, "-3": -3, "0": 0, "40.5": 40.5, "1e305": 1e305}
# The longest message that can be read at a glance, characters.
MAX_MESSAGE = 300
# A decision takes seconds; jobs of the service yield to all other programs of the machine.
LONGEST_JOB_S = 300
# The job that people edit by hand: comments, spaces and keys that the form does not have.
BY_HAND = """# the cell at the gate
robot   = "kr60ha"   # ours
seed = 7

[tool]
ball_mm = [30.0, 20.0, 10.0]
arm_radius_mm = 140.0 # measured

[bar]
length_mm = 300.0 # of May
stroke_mm = [-5.0, 5.0]
margin_mm = 0.50
sigma_um = 2.0
length_u_mm = 2e-3
expansion_per_k = 12e-6
force_n = 1.5

# the post
[[centre]]
id = 1
xyz_mm = [1300.000, 0.0, 800.0]
cup_axis = [0.0, 0.0, 1.0]
cup_limit_deg = 120.0

[[circle]]
plane = "XY" # the first
points = 12
amplitude_deg = 25.0
tilt_deg = 30.0

[[circle]]
normal = [0.0, 0.2, 0.98]
points = 8
amplitude_deg = 25.0
tilt_deg = 30.0
arc_deg = 90.0

[[obstacle]]
shape = "floor"
z_mm = 0.0
"""
# What was shown and asserted, and what the console and axe said.
counts, said = {}, []


def count(what, by=1):
    counts[what] = counts.get(what, 0) + by


def dbbd(at, *args, allowed=(0, 3)):
    done = subprocess.run([DBBD, "--quiet", *map(str, args)], cwd=at, capture_output=True, text=True, timeout=300)
    assert done.returncode in allowed, (args, done.returncode, done.stderr)
    return done


class Cell:
    """A directory with its service."""

    def __init__(self, name, config=""):
        self.path = OUT / name
        shutil.rmtree(self.path, ignore_errors=True)
        self.path.mkdir(parents=True)
        # A port of its own: pages find the service again after a restart.
        with socket.create_server(("127.0.0.1", 0)) as taken:
            port = taken.getsockname()[1]
        (self.path / "dbbd.toml").write_text(f'address = "127.0.0.1:{port}"\n{config}')
        self.begin()

    def begin(self):
        self.service, self.url = serve(DBBD, self.path)
        # A full pipe would stop the service.
        threading.Thread(target=self.service.stderr.read, daemon=True).start()

    def end(self, how="terminate"):
        getattr(self.service, how)()
        self.service.wait()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.end()


class Person:
    """A browser with a language, and a token where one is asked for."""

    def __init__(self, browser, cell, language="en", scheme="light", token=None):
        self.cell, self.language, self.texts = cell, language, TEXTS[language]
        self.context = browser.new_context(locale=LOCALES[language], color_scheme=scheme, viewport={"width": 1400, "height": 1000})
        if token:
            assert self.context.request.post(f"{cell.url}api/v1/session", data={"token": token}).ok
        self.page = self.tab()

    def tab(self):
        page = self.context.new_page()
        page.on("console", lambda m: self.complain(m.text))
        page.on("pageerror", lambda error: said.append(f"page error: {error}"))
        return page

    def complain(self, text):
        # Refusals are what is asked for here; a service that is restarted is away for a moment.
        if not re.search(r"40[0139]|422|ERR_CONNECTION|ERR_INCOMPLETE|ERR_EMPTY", text):
            said.append(text)

    def home(self):
        self.page.goto(self.cell.url)
        return self.page

    def robot(self, name, page=None):
        page = page or self.page
        page.goto(f"{self.cell.url}robot/{name}")
        expect(page.locator("[data-step=robot] [data-verdict]")).to_be_visible(timeout=20_000)
        return page

    def step(self, name, page=None):
        return (page or self.page).locator(f"[data-step={name}]")

    def look(self, what, page=None):
        """A screenshot, what axe says, and whether something is too wide."""
        page = page or self.page
        page.evaluate("scrollTo(0, 0)")
        page.screenshot(path=OUT / f"{what}.png", full_page=True)
        page.evaluate(AXE)
        for one in page.evaluate("(rules) => axe.run({ runOnly: rules })", RULES)["violations"]:
            # The word across a specimen is a watermark: it is pale so that the page below it can be read.
            if one["id"] == "color-contrast" and all("class=\"specimen\"" in node["html"] for node in one["nodes"]):
                continue
            said.append(f"axe: {one['id']} in {what}: {[node['html'][:120] for node in one['nodes']][:2]}")
        wide = page.evaluate("document.documentElement.scrollWidth - innerWidth")
        assert wide <= 0, f"{what}: {wide} px too wide"
        count("views that axe looked at")

    def api(self, path):
        answer = self.context.request.get(f"{self.cell.url}api/v1/{path}")
        assert answer.ok, (path, answer.status)
        return answer.json()


class Sent:
    """The changes that a page asks for while something is done."""

    def __init__(self, page):
        self.page, self.bodies = page, []

    def __enter__(self):
        self.page.on("request", self.note)
        return self

    def note(self, request):
        if request.method != "GET":
            self.bodies.append((request.url, request.post_data))

    def __exit__(self, *_):
        self.page.wait_for_timeout(60)
        self.page.remove_listener("request", self.note)


def files_of(path):
    """Each file below a directory and its content."""
    return {str(file.relative_to(path)): file.read_bytes() for file in sorted(path.rglob("*")) if file.is_file()}


def keys_of(table, at=""):
    """The keys of a job with their values, flat."""
    flat = {}
    for key, value in table.items():
        if isinstance(value, dict):
            flat |= keys_of(value, f"{at}{key}.")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            for place, one in enumerate(value):
                flat |= keys_of(one, f"{at}{key}[{place}].")
        else:
            flat[at + key] = value
    return flat


def changed(before, after):
    """The keys that differ between two jobs."""
    one, other = (keys_of(tomllib.loads(text)) for text in (before, after))
    return {key for key in one.keys() | other.keys() if one.get(key) != other.get(key)}


def beside(page, field):
    """The message that belongs to a field, by its description; empty if there is none."""
    return field.evaluate("""(e) =>
        (e.getAttribute("aria-invalid") === "true" && document.getElementById(e.getAttribute("aria-describedby"))?.textContent) || "" """)


def is_near(page, field):
    """The message is seen where the field is."""
    return field.evaluate("""(e) => {
        const said = document.getElementById(e.getAttribute("aria-describedby")).getBoundingClientRect(), own = e.getBoundingClientRect();
        return said.height > 0 && said.top < own.bottom + 60 && said.bottom > own.top - 60 && own.top >= 0 && own.bottom <= innerHeight;
    }""")


# The fields of the form and their keys in the file.
KEYS = {
    "length_mm": "bar.length_mm", "stroke_low_mm": "bar.stroke_mm", "stroke_high_mm": "bar.stroke_mm", "margin_mm": "bar.margin_mm", "sigma_um": "bar.sigma_um",
    "length_u_mm": "bar.length_u_mm", "temperature_c": "bar.temperature_c", "expansion_per_k": "bar.expansion_per_k", "tool_x_mm": "tool.ball_mm",
    "tool_y_mm": "tool.ball_mm", "tool_z_mm": "tool.ball_mm", "ball_u_mm": "tool.ball_u_mm", "x_mm": "centre[0].xyz_mm", "y_mm": "centre[0].xyz_mm",
    "z_mm": "centre[0].xyz_mm", "taught_deg": "centre[0].taught_deg", "centre": "circle[0].centre", "points": "circle[0].points",
    "amplitude_deg": "circle[0].amplitude_deg", "tilt_deg": "circle[0].tilt_deg", "start_deg": "circle[0].start_deg", "arc_deg": "circle[0].arc_deg",
}
# A field without a number refuses the job; the others may be empty.
NEEDED = {"length_mm", "stroke_low_mm", "stroke_high_mm", "tool_x_mm", "tool_y_mm", "tool_z_mm", "x_mm", "y_mm", "z_mm", "points"}
UNITS = {"sigma_um": "µm"}
# Places in a list of the file.
PLACES = {"stroke_low_mm": 0, "stroke_high_mm": 1} | {f"{of}{axis}_mm": place for of in ("tool_", "") for place, axis in enumerate("xyz")}


def wrong_in_form(person, form, name, untouched, never=NEVER[:4]):
    """A text that no field takes: nothing is sent, nothing is written, and the message stands beside the field."""
    field = form.locator(f"[data-name={name}]").first
    for text in [*never, *([""] if name in NEEDED else [])]:
        good = field.input_value()
        field.fill(text)
        with Sent(person.page) as sent:
            form.locator("[data-action=save]").click()
        assert not sent.bodies, (name, text, sent.bodies)
        said_here = beside(person.page, field)
        assert said_here, (name, text, "no message beside the field")
        known = [wanted.split("{")[0] for key, wanted in person.texts.items() if key.startswith("wrong.")]
        assert any(said_here.startswith(start) for start in known), (name, text, said_here)
        assert is_near(person.page, field), (name, text, "the message is not seen")
        assert untouched(), (name, text)
        count("wrong texts refused beside their field")
        field.fill(good)


def numbers(browser):
    with Cell("numbers") as cell:
        person = Person(browser, cell)
        new_robot(person, cell)
        edit_by_hand(Person(browser, cell), cell, "by-hand", NEVER, list(KEYS))
        # In German the rules are the same; what is looked at is the words.
        edit_by_hand(Person(browser, cell, "de", "dark"), cell, "von-hand", NEVER[:3], ["length_mm", "sigma_um", "points", "arc_deg"])
        scene(Person(browser, cell, "de"), cell)
        tolerance(browser, cell)


def new_robot(person, cell):
    """The form of a new robot: wrong numbers create nothing."""
    page = person.home()
    page.locator("[data-action=new-robot]").click()
    form = page.locator("#new-form")
    expect(form.locator("[data-action=save]")).to_be_visible(timeout=20_000)
    for axis, mm in zip("xyz", ("30", "20", "10")):
        form.locator(f"[data-name=tool_{axis}_mm]").fill(mm)
    form.locator("[data-name=name]").fill("made")
    fields = set(form.locator("input").evaluate_all("""(all) =>
        all.filter((e) => e.inputMode === "decimal" || e.dataset.name === "taught_deg").map((e) => e.dataset.name)"""))
    assert fields == set(KEYS), fields ^ set(KEYS)
    for name in sorted(fields):
        wrong_in_form(person, form, name, lambda: not (cell.path / "made").exists())
    person.look("new-robot-wrong")


def edit_by_hand(person, cell, name, never, fields):
    """A job that was written by hand: each field is changed alone."""
    job = cell.path / name / "job.toml"
    job.parent.mkdir()
    job.write_text(BY_HAND)
    page = person.robot(name)

    def open_form():
        person.step("robot").locator("[data-action=next]").click()
        form = page.locator("#job-form")
        expect(form.locator("[data-action=save]")).to_be_visible(timeout=20_000)
        return form

    form = open_form()
    # Nothing changed, nothing sent.
    with Sent(page) as sent:
        form.locator("[data-action=save]").click()
    assert not sent.bodies and job.read_text() == BY_HAND
    for field in fields:
        wrong_in_form(person, form, field, lambda: job.read_text() == BY_HAND, never)
    person.look(f"job-form-wrong-{person.language}")
    for field in fields:
        for text, number in PERHAPS.items():
            perhaps(person, form, job, field, text, number, open_form)


def perhaps(person, form, job, name, text, number, open_form):
    """A text that a field may take: the file has this number, and no other key is changed; or it is refused with a message."""
    page = person.page
    if not form.is_visible():
        open_form()
    field = form.locator(f"[data-name={name}]").first
    good = field.input_value()
    field.fill(text)
    with Sent(page):
        form.locator("[data-action=save]").click()
        page.wait_for_function("""() => !document.querySelector("#job-form").checkVisibility()
            || [...document.querySelectorAll("#job-form .problem, #job-form .note")].some((e) => e.textContent)""")
    after = job.read_text()
    if form.is_visible():
        assert after == BY_HAND, (name, text)
        message = beside(page, field)
        if form.locator("p.note").last.inner_text() == person.texts["form.unchanged"]:
            count("numbers that were there already")
        else:
            assert message and is_near(page, field), (name, text, "no message beside the field:", form.locator("p.problem").inner_text()[:200])
            assert len(message) < MAX_MESSAGE, (name, text, f"a message of {len(message)} characters")
            count("numbers out of range refused beside their field")
        field.fill(good)
        return
    wanted = number.get(UNITS.get(name, "mm" if name.endswith("_mm") else ""), None) if isinstance(number, dict) else number
    assert wanted is not None, (name, text, "this unit does not fit")
    assert changed(BY_HAND, after) <= {KEYS[name]}, (name, text, changed(BY_HAND, after))
    value = keys_of(tomllib.loads(after))[KEYS[name]]
    assert (value[PLACES[name]] if name in PLACES else value) == wanted, (name, text, value)
    # Of the lines only those of the key are new.
    lines = set(after.splitlines()) - set(BY_HAND.splitlines())
    assert len(lines) <= 1, (name, text, lines)
    count("numbers that were taken, with no other key changed")
    job.write_text(BY_HAND)
    page.reload()
    expect(person.step("robot").locator("[data-verdict]")).to_be_visible(timeout=20_000)
    open_form()


def scene(person, cell):
    """The fields of a ball in the view: a wrong place is neither tried nor saved."""
    name = "moved"
    (cell.path / name).mkdir()
    job = cell.path / name / "job.toml"
    job.write_text(BY_HAND)
    dbbd(job.parent, "plan", "job.toml", "--out", "plan", allowed=(0, 3))
    page = person.robot(name)
    page.locator("#scene > summary").click()
    expect(page.locator("#move-save")).to_be_visible(timeout=30_000)
    expect(page.locator("#move-x")).not_to_have_value("", timeout=20_000)
    for axis in "xyz":
        field = page.locator(f"#move-{axis}")
        for text in [*NEVER, "", "1e305"]:
            good = field.input_value()
            with Sent(page) as sent:
                field.fill(text)
                field.blur()
                page.wait_for_timeout(500)
            assert beside(page, field) and is_near(page, field), (axis, text, "no message beside the field", sent.bodies)
            # The right place that was typed before is tried, with no key changed.
            assert all(url.endswith("/trial") and keys == "{}" for url, keys in sent.bodies), (axis, text, sent.bodies)
            with Sent(page) as sent:
                page.locator("#move-save").click(force=True)
            assert not any(url.endswith("/job") for url, _ in sent.bodies) and job.read_text() == BY_HAND, (axis, text)
            field.fill(good)
            field.blur()
            count("wrong texts refused beside their field")
    person.look("scene-wrong")


def demo(cell, name="demo", truth=None):
    """A calibrated robot with its run, by the command line."""
    if not (OUT / "kept-demo").exists():
        dbbd(OUT, "demo", "--circles", "--out", "kept-demo")
        at = OUT / "kept-demo"
        dbbd(at, "plan", "--check", "job.toml", "--robot", "result/robot-identified.toml", "--out", "check-plan")
        dbbd(at, "program", "check-plan/plan.csv", "--out", "check-program")
        dbbd(at, "acquire", "--port", "sim", "--plan", "check-plan/plan.csv", "--out", "check.dbbd")
    shutil.copytree(OUT / "kept-demo", cell.path / name)
    return cell.path / name


def decide(person, text):
    """Types a tolerance and decides; returns what was asked of the service."""
    page = person.page
    page.locator("#tolerance").fill(text)
    button = person.step("check").locator("[data-action=next]")
    expect(button).to_be_enabled(timeout=30_000)
    with Sent(page) as sent:
        button.click()
    return [json.loads(body) for url, body in sent.bodies if url.endswith("/steps/check")]


def tolerance(browser, cell):
    """A tolerance is a number above 0, none at all, or refused: nothing else becomes none."""
    person = Person(browser, cell)
    at = demo(cell, "tolerated")
    page = person.robot("tolerated")
    expect(person.step("check").locator("[data-action=next]")).to_have_text(person.texts["act.check"], timeout=20_000)
    field = page.locator("#tolerance")
    for text in [*NEVER, "0", "-3", "-0", "40.5", "1e305", "1e-400", "20.0001", "0.5°"]:
        assert decide(person, text) == [], text
        assert beside(page, field) and is_near(page, field), (text, "no message beside the field")
        assert not (at / "check").exists(), text
        count("wrong texts refused beside their field")
    person.look("tolerance-wrong")
    # An empty one is none, and said to be none.
    for text, wanted in (("5", 5), ("5,0 mm", 5), ("5000 µm", 5), ("0.5 cm", 0.5e1), ("  ", None)):
        assert [body.get("tolerance_mm") for body in decide(person, text)] == [wanted], text
        expect(person.step("check")).to_have_attribute("data-state", "done", timeout=60_000)
        wait_for_idle(person, "tolerated")
        stated = json.loads((at / "check/check.json").read_text())["tolerance_mm"]
        assert stated == wanted, (text, stated)
        count("tolerances that arrived as they were typed")


def wait_for_idle(person, robot):
    """All jobs of a robot are over, and the page shows what they made."""
    def busy():
        return any(step["state"] == "running" for step in person.api(f"workbench/{robot}")["steps"])
    until = time.monotonic() + LONGEST_JOB_S
    while busy() and time.monotonic() < until:
        time.sleep(0.1)
    assert not busy()
    person.page.evaluate("dispatchEvent(new Event('focus'))")
    for step in person.api(f"workbench/{robot}")["steps"]:
        expect(person.step(step["step"])).to_have_attribute("data-state", step["state"], timeout=20_000)
        expect(person.step(step["step"]).locator("[data-verdict]")).to_have_attribute("data-verdict", step["verdict"], timeout=20_000)


# The people of a plant, and what each may do.
PEOPLE = {"anna": "plan", "otto": "plan", "ben": "measure", "cara": "look"}
HASHES = {name: hashlib.sha256(f"a token of {name}".encode()).hexdigest() for name in PEOPLE}
USERS = "".join(f'[[user]]\nname = "{name}"\nrole = "{role}"\ntoken_hash = "{HASHES[name]}"\n' for name, role in PEOPLE.items())


def files(browser):
    """What a page saves: the keys that were typed, each value, and no byte else."""
    with Cell("files") as cell:
        at = cell.path / "hand"
        at.mkdir()
        job = at / "job.toml"
        job.write_text(BY_HAND)
        person = Person(browser, cell, "de")
        page = person.robot("hand")
        person.step("cell").locator("[data-action=next]").click()
        form = page.locator("#job-form")
        for field, text in (("length_mm", "299,987"), ("taught_deg", "1; -60,5; 90; 0; 30; 0"), ("points", "16")):
            form.locator(f"[data-name={field}]").first.fill(text)
        form.locator("[data-action=save]").click()
        expect(page.locator("#message")).to_have_text(person.texts["form.saved"], timeout=20_000)
        expected = BY_HAND.replace("length_mm = 300.0 ", "length_mm = 299.987 ").replace("points = 12", "points = 16")
        expected = expected.replace("cup_limit_deg = 120.0\n", "cup_limit_deg = 120.0\ntaught_deg = [1, -60.5, 90, 0, 30, 0]\n")
        assert job.read_text() == expected, job.read_text()
        # An optional number that is emptied is gone; a circle and a ball come and go without the others.
        page.reload()
        person.step("cell").locator("[data-action=next]").click()
        form.locator("[data-name=taught_deg]").first.fill("")
        form.get_by_role("button", name=person.texts["form.add"]).last.click()
        form.locator("[data-action=save]").click()
        expect(page.locator("#message")).to_have_text(person.texts["form.saved"], timeout=20_000)
        third = {key for key in keys_of(tomllib.loads(job.read_text())) if key.startswith("circle[2]")}
        assert third and changed(expected, job.read_text()) == {"centre[0].taught_deg", *third}
        page.reload()
        person.step("cell").locator("[data-action=next]").click()
        form.get_by_role("button", name=person.texts["form.remove"]).last.click()
        form.locator("[data-action=save]").click()
        expect(page.locator("#message")).to_have_text(person.texts["form.saved"], timeout=20_000)
        assert job.read_text().strip() == expected.replace("taught_deg = [1, -60.5, 90, 0, 30, 0]\n", "").strip(), job.read_text()
        count("jobs that were saved with no other key changed", 3)
        # A job whose tool ball is in the robot file, and whose numbers have more digits than a page shows, is saved as it is.
        robot = (ROOT / "robots/kr60ha.toml").read_text() + "\n[tool]\nball_mm = [30.0, 20.0, 10.0]\n"
        (at / "own.toml").write_text(robot)
        own = re.sub(r"\[tool\]\n.*?\n\n", "", BY_HAND.replace('"kr60ha"', '"own.toml"'), flags=re.S).replace("1300.000", "1300.123456789012")
        job.write_text(own)
        page.reload()
        person.step("robot").locator("[data-action=next]").click()
        form.locator("[data-name=serial]").first.fill("K-17")
        form.locator("[data-action=save]").click()
        page.wait_for_timeout(1500)
        assert changed(own, job.read_text()) == {"serial"}, (changed(own, job.read_text()), form.locator(".problem").all_inner_texts())
        count("jobs that were saved with no other key changed")
        assert (at / "own.toml").read_text() == robot


def people(browser):
    with Cell("people", USERS) as cell:
        job = cell.path / "shared/job.toml"
        job.parent.mkdir()
        job.write_text(BY_HAND)
        dbbd(job.parent, "plan", "job.toml", "--out", "plan")
        anna, otto = Person(browser, cell, "en", token="a token of anna"), Person(browser, cell, "de", token="a token of otto")
        # Two people, and then two tabs of one.
        for second in (otto, anna):
            job.write_text(BY_HAND)
            first_page, second_page = anna.robot("shared", anna.tab()), second.robot("shared", second.tab())
            two_forms(anna, first_page, second, second_page, job)
            first_page.close()
            second_page.close()
        moved_meanwhile(anna, otto, job)
        same_name(anna, otto, cell)
        roles(browser, cell, job)


def two_forms(first, first_page, second, second_page, job):
    """Both have the form open; the second who saves is told, and wins only after a look at the job of the first."""
    forms = []
    for person, page in ((first, first_page), (second, second_page)):
        person.step("robot", page).locator("[data-action=next]").click()
        form = page.locator("#job-form")
        expect(form.locator("[data-action=save]")).to_be_visible(timeout=20_000)
        forms.append(form)
    forms[0].locator("[data-name=length_u_mm]").fill("9 µm")
    forms[1].locator("[data-name=length_u_mm]").fill("4 µm")
    with first_page.expect_response(lambda answer: answer.request.method == "PUT") as answered:
        forms[0].locator("[data-action=save]").click()
    assert answered.value.status == 204
    of_first = job.read_text()
    assert of_first == BY_HAND.replace("2e-3", "0.009"), of_first
    with second_page.expect_response(lambda answer: answer.request.method == "PUT") as answered:
        forms[1].locator("[data-action=save]").click()
    assert (answered.value.status, answered.value.json()["code"]) == (409, "E1512")
    expect(forms[1].locator("p.problem")).not_to_be_empty()
    # What was typed is still there, and the job is that of the first.
    assert forms[1].locator("[data-name=length_u_mm]").input_value() == "4 µm" and job.read_text() == of_first
    second.look(f"changed-meanwhile-{second.language}", second_page)
    second_page.once("dialog", lambda dialog: dialog.accept())
    second.robot("shared", second_page)
    second.step("robot", second_page).locator("[data-action=next]").click()
    expect(second_page.get_by_text(second.texts["form.outdated"])).to_be_visible(timeout=20_000)
    assert second_page.locator("#job-form [data-name=length_u_mm]").input_value() == "0.009"
    second_page.locator("#job-form [data-name=length_u_mm]").fill("4 µm")
    second_page.locator("#job-form [data-action=save]").click()
    expect(second_page.locator("#message")).to_have_text(second.texts["form.saved"], timeout=20_000)
    assert job.read_text() == BY_HAND.replace("2e-3", "0.004"), job.read_text()
    count("second savers who were told (E1512)")


def moved_meanwhile(anna, otto, job):
    """A ball is moved in the view while the form of another saves: the move is refused, and its refusal stays on the page."""
    job.write_text(BY_HAND)
    page = anna.robot("shared")
    page.locator("#scene > summary").click()
    expect(page.locator("#move-x")).not_to_have_value("", timeout=30_000)
    with page.expect_response(re.compile("/trial"), timeout=60_000):
        page.locator("#move-x").fill("1290")
        page.locator("#move-x").blur()
    expect(page.locator("#move-save")).to_be_enabled()
    other = otto.robot("shared")
    otto.step("robot").locator("[data-action=next]").click()
    other.locator("#job-form [data-name=serial]").first.fill("K-18")
    other.locator("#job-form [data-action=save]").click()
    expect(other.locator("#message")).to_have_text(otto.texts["form.saved"], timeout=20_000)
    of_other = job.read_text()
    with page.expect_response(lambda answer: answer.request.method == "PUT") as answered:
        page.locator("#move-save").click()
    assert (answered.value.status, answered.value.json()["code"]) == (409, "E1512") and job.read_text() == of_other
    message = page.locator("#message")
    expect(message).not_to_be_empty()
    refusal = message.inner_text()
    # The page looks at the files again by itself; what was refused must not vanish unread.
    page.evaluate("dispatchEvent(new Event('focus'))")
    page.wait_for_timeout(1500)
    assert message.inner_text() == refusal, "the refusal vanished when the page looked at its files"
    count("second savers who were told (E1512)")


def same_name(anna, otto, cell):
    """Two create a robot of one name: the second is told, and nothing of the first is changed."""
    first, second = anna.tab(), otto.tab()
    for person, page, mm in ((anna, first, "31"), (otto, second, "32")):
        page.goto(cell.url)
        page.locator("[data-action=new-robot]").click()
        form = page.locator("#new-form")
        expect(form.locator("[data-action=save]")).to_be_visible(timeout=20_000)
        form.locator("[data-name=name]").fill("twin")
        for axis in "xyz":
            form.locator(f"[data-name=tool_{axis}_mm]").fill(mm)
    first.locator("#new-form [data-action=save]").click()
    first.wait_for_url("**/robot/twin")
    made = files_of(cell.path / "twin")
    second.locator("#new-form [data-action=save]").click()
    expect(second.locator("#new-form").get_by_role("alert").filter(has_text=re.compile("."))).to_be_visible(timeout=20_000)
    assert files_of(cell.path / "twin") == made
    second.once("dialog", lambda dialog: dialog.accept())
    for page in (first, second):
        page.close()
    count("second savers who were told (E1512)")


def roles(browser, cell, job):
    """Who may only look or measure changes nothing, and the page offers nothing else."""
    before = files_of(cell.path)
    for name in ("ben", "cara"):
        person = Person(browser, cell, "en", token=f"a token of {name}")
        page = person.robot("shared")
        expect(page.locator("#user")).to_contain_text(name)
        offered = page.locator("[data-action=next]:enabled").evaluate_all("(all) => all.map((e) => e.closest('[data-step]').dataset.step)")
        assert set(offered) <= ({"measure"} if name == "ben" else set()), (name, offered)
        sha256 = person.api("workbench/shared/job")["sha256"]
        for method, path, body in (
                ("PUT", "workbench/shared/job", {"sha256": sha256, "keys": {"bar": {"length_mm": 299}}}), ("POST", "workbench", {"name": "x", "job": {}}),
                ("POST", "demo", {}), ("POST", "workbench/shared/steps/plan", {}), ("PUT", "workbench/shared/program", {"files": []}),
                *((("POST", "run", {"name": "r", "plan": None, "speed": None}), ("PUT", "device", {"port": "x"})) if name == "cara" else ())):
            answer = person.context.request.fetch(f"{cell.url}api/v1/{path}", method=method, data=body)
            assert answer.status == 403, (name, method, path, answer.status)
            count("changes that a role may not make, refused")
        person.look(f"role-{name}")
        person.home()
        expect(page.locator("[data-action=new-robot]")).to_be_disabled()
        person.context.close()
    assert files_of(cell.path) == before


def restart(browser):
    with Cell("restart") as cell:
        at = demo(cell, "cut")
        for name in ("result", "check-plan", "check-program"):
            shutil.rmtree(at / name)
        for name in ("run.dbbd", "check.dbbd", "observations.csv", "observations.provenance.json"):
            (at / name).unlink()
        (cell.path / "other").mkdir()
        (cell.path / "other/job.toml").write_text(BY_HAND)
        person, other = Person(browser, cell, "en"), Person(browser, cell, "de")
        page = person.robot("cut")
        typing = other.robot("other")
        other.step("robot").locator("[data-action=next]").click()
        typing.locator("#job-form [data-name=length_u_mm]").fill("7 µm")
        for how, ended in (("kill", "measure.cut_off"), ("terminate", "measure.early")):
            job = (at / "job.toml").read_text()
            begin_run(person, "cut")
            # What the run was planned from cannot be edited, and the form says so.
            expect(person.step("robot").locator("[data-action=next]")).to_be_disabled(timeout=20_000)
            cell.end(how)
            expect(page.locator("#link")).to_have_text(person.texts["link.down"], timeout=20_000)
            person.look(f"restart-{how}-away")
            cell.begin()
            expect(page.locator("#link")).to_be_empty(timeout=30_000)
            says = person.texts[f"say.{ended}"].split("}")[1].split("{")[0].strip()
            watching = other.robot("cut", other.tab())
            expect(other.step("measure", watching)).to_have_attribute("data-state", "attention", timeout=20_000)
            watching.close()
            person.robot("cut")
            wait_for_idle(person, "cut")
            step = next(step for step in person.api("workbench/cut")["steps"] if step["step"] == "measure")
            assert (step["state"], step["verdict"], step["text"]) == ("attention", "undecided", ended), step
            expect(person.step("measure")).to_contain_text(says)
            run = sorted((cell.path / "dbbd-runs").glob("*/run.dbbd"), key=lambda file: file.stat().st_mtime)[-1]
            line = next(line for line in dbbd(cell.path, "info", run).stdout.splitlines() if line.startswith("ended"))
            assert ("cut off" if how == "kill" else "stopped") in line, (how, line)
            assert not (at / "result").exists() and (at / "job.toml").read_text() == job
            page.locator("#live > summary").click()
            row = page.locator("#runs tr", has_text=run.parent.name)
            expect(row).to_contain_text(person.texts["runs.ended_early" if how == "kill" else "runs.ended"], timeout=20_000)
            person.look(f"restart-{how}-after")
            shown = home_row(person, "cut")
            assert shown["step"] in ("measure", "result"), shown
            assert shown["verdict"] != "pass", shown
            page = person.robot("cut")
            count("runs that were cut off by a restart and said so")
        # What was typed before the restart is still in the form.
        typing.bring_to_front()
        assert typing.locator("#job-form [data-name=length_u_mm]").input_value() == "7 µm"
        typing.locator("#job-form [data-action=save]").click()
        expect(typing.locator("#message")).to_have_text(other.texts["form.saved"], timeout=20_000)
        assert changed(BY_HAND, (cell.path / "other/job.toml").read_text()) == {"bar.length_u_mm"}


def fresh(browser):
    """The demo on a service without a port: its button starts the simulated run, also after a reload at the HALT."""
    with Cell("fresh") as cell:
        person = Person(browser, cell)
        page = person.home()
        page.locator("#speed").select_option("50")
        page.locator("[data-action=demo]").click()
        page.wait_for_url("**/robot/demo")
        halt = person.step("measure").locator("[data-action=next]")
        expect(halt).to_contain_text(person.texts["act.halt"], timeout=120_000)
        page.reload()
        expect(halt).to_contain_text(person.texts["act.halt"], timeout=60_000)
        with Sent(page) as sent:
            halt.click()
            expect(person.step("measure")).to_have_attribute("data-state", "running", timeout=30_000)
        # The program is not begun a second time.
        assert [url.rsplit("/", 1)[-1] for url, _ in sent.bodies] == ["run"], sent.bodies
        band(person, page, cell, True)


def begin_run(person, robot):
    """Starts the simulated cell from the step Measure, and waits for its first poses."""
    page = person.page
    next_button = person.step("measure").locator("[data-action=next]")
    expect(next_button).to_have_text(person.texts["act.simulate"], timeout=20_000)
    next_button.click()
    expect(next_button).to_contain_text(person.texts["act.halt"], timeout=60_000)
    next_button.click()
    expect(person.step("measure")).to_have_attribute("data-state", "running", timeout=30_000)
    expect(page.locator("#plot circle:not(.ring):not(.nominal)").nth(3)).to_be_attached(timeout=90_000)


def home_row(person, robot):
    """What the first page says of a robot."""
    page = person.context.new_page()
    page.goto(person.cell.url)
    row = page.locator("#robots li", has=page.get_by_role("link", name=robot, exact=True))
    expect(row.locator("[data-verdict]")).to_be_visible(timeout=20_000)
    line = row.locator("[data-verdict]")
    says = line.inner_text()
    names = {person.texts[f"step.{step}"]: step for step in ("robot", "cell", "plan", "programs", "measure", "result", "correct", "check", "certificate")}
    found = {"verdict": line.get_attribute("data-verdict"), "step": next(step for name, step in names.items() if f"{name}: " in says), "says": says,
             "simulated": person.texts["simulated.result"] in row.inner_text()}
    page.close()
    return found


# What each decision makes of the other steps and documents: the verdict of the check and of the result, the states of the steps
# Correct and Certificate before a certificate is made, and the words of `dbbd info` for the identified robot.
DECIDED = {
    "pass": ("pass", "pass", None), "unchanged": ("pass", "none", None), "undecided": ("undecided", "undecided", "its last check decided nothing"),
    "fail": ("fail", "fail", "its last check failed"), "changed": ("fail", "fail", "its last check failed"),
}
# The shapes of the verdicts in the reports.
WORDS = {"pass": "✓", "none": "•", "fail": "✕", "undecided": "?"}


def states(browser):
    with Cell("states") as cell:
        at = demo(cell, "decided")
        english, german = Person(browser, cell), Person(browser, cell, "de", "dark")
        # The robot as it was identified; then its axis 3 was knocked.
        for tolerance, decision in (("5", "pass"), ("", "unchanged"), ("1,5", "undecided"), ("2.375", "pass")):
            decided(english, german, at, tolerance, decision)
        knock(at)
        for tolerance, decision in (("2", "fail"), ("", "changed")):
            decided(english, german, at, tolerance, decision)
        newer(english, at)
        of_typed_lengths(english, cell)


def knock(at):
    """A collision: an axis of the true robot stands elsewhere; the check is measured again."""
    truth = (at / "truth.toml").read_text()
    offsets = re.findall(r"theta_offset_deg = \S+", truth)
    old = offsets[2]
    new = f"theta_offset_deg = {float(old.split()[-1]) + 0.4}"
    (at / "truth.toml").write_text(truth.replace(old, new))
    (at / "check.dbbd").unlink()
    dbbd(at, "acquire", "--port", "sim", "--plan", "check-plan/plan.csv", "--out", "check.dbbd")


def decided(english, german, at, tolerance, decision):
    robot = at.name
    page = english.robot(robot)
    button = english.step("check").locator("[data-action=next]")
    expect(button).to_have_text(re.compile(f"{english.texts['act.check']}|{english.texts['act.check_again']}"), timeout=20_000)
    asked = decide(english, tolerance)
    wait_for_idle(english, robot)
    check = json.loads((at / "check/check.json").read_text())
    assert check["decision"] == decision, (tolerance, check["decision"], check["position_error_mm"], check["upper_mm"], check["lower_mm"])
    stated = float(tolerance.replace(",", ".")) if tolerance else None
    assert check["tolerance_mm"] == stated and asked[0].get("tolerance_mm") == stated
    # A decision that is made again after a reload, or by another person, has the same tolerance.
    for person in (english, german):
        person.robot(robot)
        again = person.step("check").locator("[data-action=next]")
        expect(again).to_have_text(person.texts["act.check_again"], timeout=20_000)
        with Sent(person.page) as sent:
            again.click()
        assert [json.loads(body).get("tolerance_mm") for _, body in sent.bodies] == [stated], (decision, person.language, sent.bodies)
        wait_for_idle(person, robot)
        assert json.loads((at / "check/check.json").read_text())["tolerance_mm"] == stated
        count("decisions that were made again with the same tolerance")
    of_check, of_result, standing = DECIDED[decision]
    agree(english, german, at, decision, of_check, of_result, standing)
    # The certificate of the step: of simulated readings only a specimen.
    shutil.rmtree(at / "certificate", ignore_errors=True)
    english.robot(robot)
    made = english.step("certificate").locator("[data-action=next]")
    expect(made).to_be_enabled(timeout=20_000)
    made.click()
    page.wait_for_timeout(300)
    wait_for_idle(english, robot)
    certificate = (at / "certificate/certificate.html").read_text()
    assert certificate.count("SPECIMEN") >= 4 and "traceable to the SI" not in certificate
    statement = re.sub(r"<[^>]+>", " ", certificate.partition("Statement</h2>")[2])[:400]
    assert {"pass": "Valid", "none": "Identified", "undecided": "Undecided", "fail": "Not valid"}[of_result] in statement, (decision, statement)
    # Without being asked for a specimen the command line refuses.
    refused = dbbd(at, "certificate", "result", "--check", "check", "--out", "never", allowed=(1,))
    assert "E2008" in refused.stderr and not (at / "never").exists()
    agree(english, german, at, decision, of_check, of_result, standing)
    english.robot(robot)
    english.look(f"decided-{decision}-en")
    german.robot(robot)
    german.look(f"decided-{decision}-de")
    for kind in ("check", "certificate"):
        report = english.context.new_page()
        report.goto(f"{english.cell.url}api/v1/workbench/{robot}/files/{kind}/{kind}.html?lang=en")
        report.evaluate("document.querySelectorAll('details').forEach((one) => (one.open = true))")
        english.look(f"{kind}-{decision}-en", report)
        report.close()
    count("decisions that all documents state alike")


def agree(english, german, at, decision, of_check, of_result, standing):
    """Home page, steps, reports and `dbbd info` say the same of a robot."""
    robot = at.name
    for person in (english, german):
        person.robot(robot)
        wait_for_idle(person, robot)
        for step, verdict in (("check", of_check), ("result", of_result)):
            expect(person.step(step).locator("[data-verdict]")).to_have_attribute("data-verdict", verdict)
        row = home_row(person, robot)
        assert (row["step"], row["verdict"], row["simulated"]) == ("check", of_check, True), (decision, row)
        sentence = person.step("check").locator("[data-verdict]").inner_text()
        assert sentence.strip() in re.sub(r"\s+", " ", row["says"]) or row["says"].endswith(sentence), (row["says"], sentence)
        expect(person.page.locator("#simulated-readings")).to_be_visible()
        lang = person.language
        for directory, file, verdict in (("check", "check", of_check), ("result", "report", of_result)):
            report = person.context.new_page()
            report.goto(f"{person.cell.url}api/v1/workbench/{robot}/files/{directory}/{file}.html?lang={lang}")
            shown = report.locator("[data-verdict]").first.get_attribute("data-verdict")
            if file == "report":
                # A report is of the day on which it was made. Without a tolerance it decides nothing: it has the uncertainty of that day.
                if shown not in (verdict, "none"):
                    old.append((decision, shown, verdict))
            else:
                assert shown == verdict, (decision, file, shown, verdict)
            if file == "check":
                numbers_agree(person, sentence, report.locator("[data-verdict]").first.inner_text())
                assert report.locator("[data-verdict]").first.inner_text().lstrip()[0] == WORDS[verdict]
            expect(report.locator("p.simulated").first).to_be_visible()
            report.close()
            count("documents compared")
    said_by_info = dbbd(at, "info", "result/robot-identified.toml").stdout
    line = next((line for line in said_by_info.splitlines() if line.startswith("standing")), "")
    assert (standing is None and "not to be used" not in line and "decided nothing" not in line) or (standing and standing in line), (decision, line)
    assert "simulated" in said_by_info
    count("documents compared")


# Reports of a result that a later check contradicts: the decision, what the report says, and what is true now.
old = []


def numbers_agree(person, one, other):
    """The lengths in the sentence of the page are in that of the report, with the same digits."""
    of = [set(re.findall(r"[\d.,−]+ mm", text)) for text in (one, other)]
    assert of[0] and of[0] <= of[1], (person.language, of)


def newer(person, at):
    """A run that is newer than the result: result and certificate are old, and a check of the old one decides nothing about the new one."""
    robot = at.name
    dbbd(at, "acquire", "--port", "sim", "--plan", "plan/plan.csv", "--out", "run-2.dbbd")
    person.robot(robot)
    wait_for_idle(person, robot)
    steps = {step["step"]: step for step in person.api(f"workbench/{robot}")["steps"]}
    assert (steps["result"]["state"], steps["result"]["text"]) == ("ready", "result.stale"), steps["result"]
    assert steps["result"]["verdict"] == "none"
    person.look("newer-run")
    person.step("result").locator("[data-action=next]").click()
    person.page.wait_for_timeout(500)
    wait_for_idle(person, robot)
    steps = {step["step"]: step for step in person.api(f"workbench/{robot}")["steps"]}
    assert steps["result"]["verdict"] in ("pass", "undecided"), steps["result"]
    assert steps["check"]["verdict"] == "none" and steps["check"]["text"] == "check.stale", steps["check"]
    assert steps["certificate"]["text"] == "certificate.stale", steps["certificate"]
    row = home_row(person, robot)
    assert row["step"] == "result" and row["verdict"] == steps["result"]["verdict"], row
    line = [line for line in dbbd(at, "info", "result/robot-identified.toml").stdout.splitlines() if line.startswith("standing")]
    assert not any("failed" in one or "decided nothing" in one for one in line), line
    person.look("newer-result")
    count("old results that were called old")


def of_typed_lengths(person, cell):
    """A robot of lengths of which nothing is known may be a real one; a simulated check of it is called simulated everywhere."""
    at = demo(cell, "typed")
    shutil.rmtree(at / "result")
    (at / "observations.provenance.json").unlink()
    (at / "run.dbbd").unlink()
    dbbd(at, "identify", "observations.csv", "--robot", "kr60ha", "--tool", "30,20,10", "--centres", "plan/centres.csv", "--folds", "0", "--out", "result")
    (at / "truth.toml").unlink()
    page = person.robot("typed")
    expect(page.locator("#simulated-readings")).to_be_hidden()
    assert not home_row(person, "typed")["simulated"]
    person.step("certificate").locator("[data-action=next]").click()
    page.wait_for_timeout(500)
    wait_for_idle(person, "typed")
    certificate = (at / "certificate/certificate.html").read_text()
    assert "SPECIMEN" not in certificate
    shutil.rmtree(at / "certificate")
    # Its check was planned for the robot that was identified before.
    for name in ("check-plan", "check-program"):
        shutil.rmtree(at / name)
    (at / "check.dbbd").unlink()
    shutil.copy(OUT / "kept-demo/truth.toml", at / "truth.toml")
    dbbd(at, "plan", "--check", "job.toml", "--robot", "result/robot-identified.toml", "--out", "check-plan")
    dbbd(at, "program", "check-plan/plan.csv", "--out", "check-program")
    dbbd(at, "acquire", "--port", "sim", "--plan", "check-plan/plan.csv", "--out", "check.dbbd")
    (at / "truth.toml").unlink()
    person.robot("typed")
    decide(person, "5")
    wait_for_idle(person, "typed")
    assert "class=\"simulated\"" in (at / "check/check.html").read_text()
    person.look("simulated-check-of-a-real-robot")
    person.step("certificate").locator("[data-action=next]").click()
    page.wait_for_timeout(500)
    wait_for_idle(person, "typed")
    made = at / "certificate/certificate.html"
    assert not made.exists() or "SPECIMEN" in made.read_text(), "a certificate of simulated readings"
    expect(page.locator("#simulated-readings")).to_be_visible(timeout=5000)
    assert home_row(person, "typed")["simulated"]


class PlayedBar:
    """A bar of another program: readings as text over TCP, 200 a second, to one client after the other."""

    def __init__(self):
        self.server = socket.create_server(("127.0.0.1", 0))
        self.port = self.server.getsockname()[1]
        threading.Thread(target=self.play, daemon=True).start()

    def play(self):
        sample = 0
        while True:
            client, _ = self.server.accept()
            try:
                while True:
                    # Clock in µs, reading in mm.
                    client.sendall(f"{sample * 5000},1.2500\r\n".encode())
                    sample += 1
                    time.sleep(0.005)
            except OSError:
                client.close()




def beside_a_bar(browser):
    """The demo runs while the service has a bar that is no virtual one: what is called simulated is what is simulated."""
    bar = PlayedBar()
    with Cell("beside", f'[device]\nport = "tcp://127.0.0.1:{bar.port}"\nprotocol = "dbb-csv-1"\n') as cell:
        demo(cell, "demo-cell")
        (cell.path / "real").mkdir()
        (cell.path / "real/job.toml").write_text(BY_HAND)
        dbbd(cell.path / "real", "plan", "job.toml", "--out", "plan")
        dbbd(cell.path / "real", "program", "plan/plan.csv", "--out", "program")
        watcher, operator = Person(browser, cell, "de", "dark"), Person(browser, cell, "en")
        watched = watcher.page
        watched.goto(f"{cell.url}live")
        watched.locator("#connect").click()
        expect(watched.locator("#state")).to_have_text(watcher.texts["state.reading"], timeout=20_000)
        expect(watched.locator("#value")).to_contain_text("1,250", timeout=20_000)
        band(watcher, watched, cell, False)
        watcher.look("bar-of-another-program-de")
        # A run of the bar as it is: measured.
        record(watcher, cell, "played")
        # The demo beside it.
        page = operator.robot("demo-cell")
        again = operator.step("measure").locator("[data-action=next]")
        expect(again).to_be_enabled(timeout=20_000)
        label = again.inner_text()
        print("beside a bar the step Measure of a simulated cell says:", label)
        again.click()
        expect(again).to_contain_text(operator.texts["act.halt"], timeout=60_000)
        band(operator, page, cell, True)
        band(watcher, watched, cell, True)
        again.click()
        expect(operator.step("measure")).to_have_attribute("data-state", "running", timeout=30_000)
        band(operator, page, cell, True)
        band(watcher, watched, cell, True)
        watcher.look("demo-beside-a-bar-de")
        page.locator("#stop").click()
        page.locator("#confirm button[value=yes]").click()
        expect(operator.step("measure")).not_to_have_attribute("data-state", "running", timeout=60_000)
        # The bar of the service is what it was.
        assert watcher.api("status")["device"]["port"] == f"tcp://127.0.0.1:{bar.port}"
        # Its page had connected it before, and does so again.
        expect(watched.locator("#state")).to_have_text(watcher.texts["state.reading"], timeout=20_000)
        expect(watched.locator("#value")).to_contain_text("1,250", timeout=20_000)
        band(watcher, watched, cell, False)
        # A robot whose bar is real has no band, and its run is measured.
        real = operator.robot("real")
        band(operator, real, cell, False)
        expect(real.locator("#simulated-readings")).to_be_hidden()
        assert not home_row(operator, "real")["simulated"] and home_row(operator, "demo-cell")["simulated"]
        for run in (cell.path / "dbbd-runs").glob("*/run.dbbd"):
            info = json.loads(dbbd(cell.path, "info", run, "--json").stdout)
            wanted = "measured" if run.parent.name == "played" else "simulated"
            assert info["origin"] == wanted, (run.parent.name, info["origin"])
            count("runs whose origin is what it was")


def record(person, cell, name):
    """A run of the bar without a plan, for a second."""
    page = person.page
    page.locator("#name").fill(name)
    # Another plan connects the bar again, which takes a moment.
    with page.expect_response(re.compile("/reading")):
        page.locator("#plan").select_option("")
    expect(page.locator("#state")).to_have_text(person.texts["state.reading"], timeout=20_000)
    expect(page.locator("#value")).to_contain_text("1,250", timeout=20_000)
    for box in page.locator("#checks input").all():
        box.check()
    page.locator("#start").click()
    expect(page.locator("#state")).to_have_text(person.texts["state.running"], timeout=20_000)
    band(person, page, cell, False)
    page.wait_for_timeout(1000)
    page.locator("#stop").click()
    page.locator("#confirm button[value=yes]").click()
    expect(page.locator("#state")).to_have_text(person.texts["state.reading"], timeout=20_000)


def band(person, page, cell, is_simulated):
    """The band over the page says what the service reads."""
    shown = page.locator("#simulated")
    (expect(shown).to_be_visible if is_simulated else expect(shown).to_be_hidden)(timeout=10_000)
    now = person.api("status")
    assert (now["run"] or now["reading"])["simulated"] == is_simulated if (now["run"] or now["reading"]) else not is_simulated
    count("bands that say what is read")


PARTS = {"numbers": numbers, "files": files, "people": people, "fresh": fresh, "restart": restart, "states": states, "beside": beside_a_bar}


def main():
    OUT.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        graphics = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", *graphics])
        for part in sys.argv[3:] or PARTS:
            began = time.monotonic()
            PARTS[part](browser)
            print(f"{part}: {time.monotonic() - began:.0f} s", flush=True)
        browser.close()
    for what, number in sorted(counts.items()):
        print(f"{number:5} {what}")
    print("reports that a later check contradicts:", sorted(set(old)) or "none")
    print("console and axe:", said or "silent")
    assert not said and not old


main()
