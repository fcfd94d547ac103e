"""Carries a robot through the workbench in headless Chromium: from an empty directory to the certificate.

    pip install playwright axe-playwright-python pillow
    python tests/clients/workbench.py target/release/dbbd OUT [FORM ..]
    python tests/clients/workbench.py target/release/dbbd OUT --pictures

Serves an empty directory, makes a robot by the form, sees a plan refused, mends it, moves a ball, runs the demo, leaves a length
out, corrects a program, plans and measures a check, and makes the certificate. At a desk each step is disturbed: the page is loaded
again, a second browser looks, the connection is lost, the bar is unplugged. Then compares the result with that of the command
line on the same run. A form is a size, a language, a scheme, and with or without a token, as `phone-de-dark-open`; without one all
forms of the list are played: each pair of two properties is among them. Screenshots go to OUT; with --pictures those of the steps
are renewed in docs/workbench/. Asserts that the console and axe are
silent, how much the first view loads, and how long a frame of the view in three dimensions takes.
"""

import gzip
import json
import os
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import time

from PIL import Image

from browser import AXE, CHROMIUM, expect, serve, sync_playwright

DBBD, OUT = pathlib.Path(sys.argv[1]).resolve(), pathlib.Path(sys.argv[2]).resolve()
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa", "best-practice"]
TOKEN = "a-token-for-the-workbench"
ROOT = pathlib.Path(__file__).parents[2]
TEXTS = {file.stem: json.loads(file.read_text()) for file in (ROOT / "src/live/page/texts").glob("??.json")}
SIZES = {"desktop": (1400, 1000), "tablet": (820, 1180), "phone": (390, 844)}
LOCALES = {"en": "en-GB", "de": "de-DE"}
# Every pair of a size, a language, a scheme and a token is in one of them.
FORMS = [
    "desktop-en-light-token", "desktop-de-dark-open", "tablet-en-dark-token", "tablet-de-light-open",
    "phone-en-dark-open", "phone-de-light-token", "desktop-de-light-token", "phone-en-light-open",
]
# The form whose pictures the book shows, and the height to which they are cut, pixels.
PICTURED, MAX_PICTURE = "desktop-en-light-token", 900
# Device time of the simulated cell per host time.
SPEED = "50"
# The tool ball of the new robot, that of the demo.
TOOL_MM = ("30", "20", "10")
# Bytes of the first view, each file compressed.
MAX_FIRST_VIEW = 300_000
# Median time of a frame while the view turns, ms.
MAX_FRAME_MS = 30
# The parts of a report whose words are the page's own.
OWN_WORDS = "h1, h2, h3, th, dt, summary, strong, [data-verdict] p"
said = []


def configure(cell, token):
    asked = ""
    if token:
        (cell / "token").write_text(TOKEN)
        (cell / "token").chmod(0o600)
        asked = 'token_file = "token"\n'
    (cell / "dbbd.toml").write_text(f'address = "127.0.0.1:0"\n{asked}[device]\nport = "bar"\n')


class Bar:
    """A virtual bar at the port `bar` of a directory, which can be pulled."""

    def __init__(self, cell):
        self.cell = cell
        self.plug()

    def plug(self):
        program = next(self.cell.glob("*/program/DBB_MAIN.src"))
        self.process = subprocess.Popen(
            [DBBD, "simulate", "--program", program, "--tool", ",".join(TOOL_MM), "--link", "bar"], cwd=self.cell,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        while not (self.cell / "bar").exists():
            time.sleep(0.05)

    def pull(self):
        self.process.kill()
        self.process.wait()
        (self.cell / "bar").unlink(missing_ok=True)


class Story:
    def __init__(self, browser, service, url, form, out):
        self.browser, self.service, self.url, self.form, self.out = browser, service, url, form, out
        size, self.language, scheme, token = form.split("-")
        self.texts, self.token, self.size = TEXTS[self.language], token == "token", size
        width, height = SIZES[size]
        self.context = browser.new_context(
            viewport={"width": width, "height": height}, locale=LOCALES[self.language], color_scheme=scheme, has_touch=size == "phone")
        self.page = self.context.new_page()
        self.page.on("console", lambda m: self.complain(m.text))
        self.page.on("pageerror", lambda error: said.append(f"{form}: {error}"))
        self.shots = 0
        self.is_cut = False

    def text(self, key):
        """A text of the page up to its first value."""
        return self.texts[key].split("{")[0].strip()

    def complain(self, text):
        # What the story provokes: no token yet, refused jobs, and a lost connection.
        if not re.search(r"40[19]|422", text) and not (self.is_cut and "ERR_INTERNET_DISCONNECTED" in text):
            said.append(f"{self.form}: {text}")

    def step(self, name):
        return self.page.locator(f"[data-step={name}]")

    def next(self, name):
        self.step(name).locator("[data-action=next]").click()

    def state(self, name, wanted, seconds=120):
        expect(self.step(name)).to_have_attribute("data-state", wanted, timeout=1000 * seconds)

    def look(self, what):
        """A screenshot, what axe says, and whether something is too wide."""
        self.shots += 1
        # What lies under the head of the page cannot be reached there.
        self.page.evaluate("scrollTo(0, 0)")
        self.page.screenshot(path=self.out / f"{self.shots:02}-{what}.png", full_page=True)
        self.page.evaluate(AXE)
        found = self.page.evaluate("(rules) => axe.run({ runOnly: rules })", RULES)
        for one in found["violations"]:
            print("axe", self.form, what, one["id"], [node["html"][:150] for node in one["nodes"]][:3])
            said.append(f"axe: {one['id']} in {what} of {self.form}")
        wide = self.page.evaluate("document.documentElement.scrollWidth - innerWidth")
        assert wide <= 0, f"{what}, {self.form}: {wide} px too wide"

    def disturb(self, *steps):
        """What happens beside the work: each step shows the same afterwards, and what is true meanwhile."""
        if self.size != "desktop":
            return
        for step in steps:
            state = self.step(step).get_attribute("data-state")
            sentence = self.step(step).locator("[data-verdict]").inner_text()
            self.page.reload()
            self.shows(self.page, step, state, sentence)
            self.look_from_elsewhere(step, state, sentence)
            self.cut(step)
            self.shows(self.page, step, state, sentence)

    def shows(self, page, step, state, sentence):
        shown = page.locator(f"[data-step={step}]")
        expect(shown).to_have_attribute("data-state", state, timeout=20_000)
        expect(shown.locator("[data-verdict]")).to_have_text(sentence, use_inner_text=True, timeout=20_000)

    def look_from_elsewhere(self, step, state, sentence):
        """A browser of its own, with the same language."""
        other = self.browser.new_context(locale=LOCALES[self.language])
        if self.token:
            assert other.request.post(f"{self.url}api/v1/session", data={"token": TOKEN}).ok
        page = other.new_page()
        page.goto(self.page.url)
        self.shows(page, step, state, sentence)
        other.close()

    def cut(self, step):
        """Without a connection the page says so; what is asked then is not done, and said to be so."""
        # The stream of a service that does not answer falls silent.
        self.service.send_signal(signal.SIGSTOP)
        expect(self.page.locator("#link")).to_have_text(self.texts["link.down"], timeout=20_000)
        self.service.send_signal(signal.SIGCONT)
        expect(self.page.locator("#link")).to_be_empty(timeout=20_000)
        self.is_cut = True
        # A browser goes off the network, and back, a moment after it was told to: the page is asked to look until it says so.
        said = "text => (dispatchEvent(new Event('focus')), document.getElementById('message').textContent === text)"
        for offline, text in ((True, self.texts["link.none"]), (False, "")):
            self.context.set_offline(offline)
            self.page.wait_for_function(said, arg=text, polling=500, timeout=20_000)
        self.is_cut = False

    def unplug(self, cell, *steps):
        """The bar is unplugged and plugged in again while its reading is shown: the page says so, and each step keeps its state."""
        if self.size != "desktop":
            return
        bar = Bar(cell)
        self.ask("PUT", "device", {"port": "bar"})
        self.ask("POST", "reading", {"plan": None, "speed": None})
        for step in steps:
            state = self.step(step).get_attribute("data-state")
            expect(self.page.locator("#state")).to_have_text(self.texts["state.reading"], timeout=20_000)
            bar.pull()
            expect(self.page.locator("#state")).to_have_text(self.texts["state.gone"], timeout=20_000)
            self.page.reload()
            expect(self.page.locator("#state")).to_have_text(self.texts["state.gone"], timeout=20_000)
            expect(self.step(step)).to_have_attribute("data-state", state, timeout=20_000)
            bar.plug()
            expect(self.page.locator("#state")).to_have_text(self.texts["state.reading"], timeout=20_000)
            expect(self.step(step)).to_have_attribute("data-state", state)
        if "measure" in steps:
            self.pull_in_a_run(bar)
        else:
            self.ask("DELETE", "reading")
        bar.pull()

    def pull_in_a_run(self, bar):
        """A run waits for its bar, goes on, and is one that ended early when it is stopped."""
        self.ask("POST", "run", {"name": "pulled", "plan": "cell-1/plan", "checked": [], "speed": None})
        self.state("measure", "running", 30)
        state = self.page.locator("#state")
        bar.pull()
        expect(state).to_have_text(self.texts["state.gone"], timeout=20_000)
        self.state("measure", "running")
        bar.plug()
        expect(state).to_have_text(self.texts["state.running"], timeout=20_000)
        self.page.locator("#stop").click()
        self.page.locator("#confirm button[value=yes]").click()
        self.state("measure", "attention", 30)
        expect(self.step("measure")).to_contain_text(self.texts["ending.stopped"])

    def ask(self, method, path, body=None):
        """A request of the page itself."""
        send = """async ([method, path, body]) => (await fetch(`/api/v1/${path}`, {
            method, headers: body ? { "Content-Type": "application/json" } : {}, body: body && JSON.stringify(body) })).status"""
        status = self.page.evaluate(send, [method, path, body])
        assert status < 300, (method, path, status)

    def picture(self, step):
        """The step as the book shows it, without the head of the page above it."""
        self.page.evaluate("document.querySelectorAll('.top, #step-nav').forEach((one) => (one.style.position = 'static'))")
        self.step(step).screenshot(path=self.out / f"step-{step}.png")
        self.page.evaluate("document.querySelectorAll('.top, #step-nav').forEach((one) => one.style.removeProperty('position'))")

    def sign_in(self):
        self.page.goto(self.url)
        dialog = self.page.locator("[data-sign-in]")
        if not self.token:
            expect(dialog).to_be_hidden()
            return
        expect(dialog).to_be_visible(timeout=10_000)
        self.look("sign-in")
        dialog.locator("input").fill(TOKEN)
        dialog.locator("button").click()
        expect(dialog).to_be_hidden()

    def make_a_robot(self, cell):
        """By the form. A bar that no robot reaches is refused with its cure, and the mended job is planned."""
        self.page.locator("[data-action=new-robot]").click()
        form = self.page.locator("#new-form")
        form.locator("[data-name=name]").fill("cell-1")
        for axis, mm in zip("xyz", TOOL_MM):
            form.locator(f"[data-name=tool_{axis}_mm]").fill(mm)
        form.locator("[data-name=length_mm]").fill("0.3")
        form.locator("[data-action=save]").click()
        # The message of the service stands beside the field that it names.
        expect(form.get_by_role("alert").filter(has_text="length_mm")).to_be_visible(timeout=10_000)
        self.look("units")
        form.locator("[data-name=length_mm]").fill("300")
        form.locator("[data-name=x_mm]").fill("9300")
        form.locator("[data-action=save]").click()
        self.page.wait_for_url("**/robot/cell-1")
        self.state("cell", "done")
        self.next("plan")
        self.state("plan", "attention")
        expect(self.step("plan").locator("[data-verdict]")).to_have_attribute("data-verdict", "fail")
        expect(self.step("plan")).to_contain_text(self.texts["finding.cure"])
        self.look("refused")
        self.next("cell")
        job = self.page.locator("#job-form")
        job.locator("[data-name=x_mm]").fill("1300")
        job.locator("[data-action=save]").click()
        self.next("plan")
        self.state("plan", "done")
        self.next("programs")
        self.state("programs", "done")
        self.state("measure", "ready")
        self.disturb("robot", "cell", "plan", "programs", "measure")
        self.unplug(cell, "robot", "cell", "plan", "programs", "measure")

    def demo(self):
        self.page.goto(self.url)
        expect(self.page.get_by_role("link", name="cell-1")).to_be_visible(timeout=10_000)
        self.page.locator("#speed").select_option(SPEED)
        loaded = {}
        self.page.on("response", lambda answer: loaded.setdefault(answer.url, answer))
        self.page.locator("[data-action=demo]").click()
        self.page.wait_for_url("**/robot/demo")
        self.page.wait_for_load_state("load")
        files = [answer for answer in list(loaded.values()) if "/api/" not in answer.url and "/vendor/" not in answer.url]
        weight = sum(len(gzip.compress(answer.body())) for answer in files)
        print(f"{self.form}: the first view loads {weight} bytes in {len(files)} files, compressed")
        assert 20_000 < weight < MAX_FIRST_VIEW, weight
        self.state("programs", "done")
        self.halt("measure")
        self.state("result", "done", 300)
        self.look("result")

    def leave_out(self, cell):
        """A length by its table, with a reason; the result is computed again and says so, and the length is taken in again."""
        result = json.loads((cell / "demo/result/result.json").read_text())
        fold = self.page.locator("#residuals")
        fold.locator("summary").first.click()
        fold.locator("summary").nth(1).click()
        row = fold.locator("#residual-rows tr").nth(20)
        index = int(row.locator("th").inner_text())
        row.get_by_role("button").click()
        self.page.locator("#exclude-why").fill("the bar was touched")
        self.look("residuals")
        self.compute_again(fold)
        excluded = json.loads((cell / "demo/result/result.json").read_text())
        assert [(one["index"], one["reason"]) for one in excluded["excluded"]] == [(index, "the bar was touched")]
        assert excluded["measurements"] == result["measurements"] - 1
        expect(self.step("result")).to_contain_text(f"--exclude '{index}:the bar was touched'")
        expect(fold.locator("#exclude-list")).to_contain_text(str(index))
        fold.locator(f"[data-row='{index}']").click()
        self.compute_again(fold)
        again = json.loads((cell / "demo/result/result.json").read_text())
        assert again["parameters"] == result["parameters"] and not again["excluded"]
        fold.locator("summary").first.click()

    def compute_again(self, fold):
        with self.page.expect_response(re.compile("/steps/result")):
            fold.locator("[data-action=again]").click()
        self.state("result", "running", 10)
        self.state("result", "done")
        expect(fold.locator("[data-action=again]")).to_be_disabled(timeout=20_000)

    def halt(self, step):
        button = self.step(step).locator("[data-action=next]")
        expect(button).to_contain_text(self.text("act.halt"), timeout=60_000)
        button.click()
        self.state(step, "running", 30)
        expect(self.page.locator("#stop")).to_be_visible()
        if step == "measure":
            expect(self.page.locator("#trace canvas")).to_be_visible(timeout=20_000)
            # What was seen so far is there after a reload, too.
            expect(self.page.locator("#plot circle:not(.ring):not(.nominal)").nth(5)).to_be_attached(timeout=60_000)
            seen = self.page.locator("#plot circle:not(.ring):not(.nominal)").count()
            self.page.reload()
            self.page.locator("#live > summary").click()
            expect(self.page.locator("#plot circle:not(.ring):not(.nominal)").nth(seen - 1)).to_be_attached(timeout=20_000)
            expect(self.page.locator("#trace canvas")).to_be_visible(timeout=20_000)
            # What the run was planned from is locked.
            locked = """async () => {
                const job = "/api/v1/workbench/demo/job";
                const { sha256 } = await (await fetch(job)).json();
                const body = JSON.stringify({ sha256, keys: { bar: { sigma_um: 3 } } });
                return (await fetch(job, { method: "PUT", headers: { "Content-Type": "application/json" }, body })).status;
            }"""
            assert self.page.evaluate(locked) == 409
            self.look("running")
            self.picture("measure")
            self.disturb(step)

    def scene(self):
        scene = self.page.locator("[data-scene]")
        scene.locator("summary").first.click()
        expect(scene.locator("#scene-rows tr").nth(100)).to_be_attached(timeout=20_000)
        before = int(scene.get_attribute("data-pose"))
        scene.locator("#scene-next").click()
        assert int(scene.get_attribute("data-pose")) > before
        scene.locator("#scene-play").click()
        expect(scene).to_have_attribute("data-playing", "true")
        scene.locator("#scene-play").click()
        expect(scene).to_have_attribute("data-playing", "false")
        scene.locator("#scene-arrows").check()
        self.look("scene")
        self.picture("cell")
        self.frames()
        self.move(scene)
        scene.locator("summary").first.click()

    def frames(self):
        """The median time from frame to frame while the view of 250 poses is turned by its keys."""
        turn = """async () => {
            const canvas = document.getElementById("scene-canvas");
            canvas.focus();
            const times = [];
            for (let i = 0; i < 60; i++) {
                canvas.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft", bubbles: true }));
                await new Promise(requestAnimationFrame);
                times.push(performance.now());
            }
            const gaps = times.slice(1).map((time, i) => time - times[i]).sort((a, b) => a - b);
            return [gaps[gaps.length >> 1], canvas.width, canvas.height];
        }"""
        median, width, height = self.page.evaluate(turn)
        print(f"{self.form}: a frame of {width} x {height} pixels takes {median:.1f} ms in the median")
        # Beside other programs it is no measure of this one.
        busy = os.getloadavg()[0] > os.cpu_count()
        assert busy or self.size != "desktop" or median < MAX_FRAME_MS, median

    def move(self, scene):
        """A ball moved out of reach is refused while it moves; back where it was, the plan passes. Nothing is written."""
        x, found = scene.locator("#move-x"), scene.locator("#move-found")
        for wanted, shown in (("9300", "E0130"), ("1500", "✓")):
            with self.page.expect_response(re.compile("/trial")):
                x.fill(wanted)
                x.press("Enter")
                x.blur()
            expect(found).to_contain_text(shown, timeout=20_000)
        self.look("moved")
        expect(scene.locator("#move-save")).to_be_disabled()

    def correct(self, cell):
        program = cell / "demo" / "program"
        # Some modules reach poses whose correction is beyond its limit.
        robot = ["--robot", cell / "demo" / "result", "--out", self.out / "corrected"]
        passes = lambda module: subprocess.run([DBBD, "compensate", module, *robot], capture_output=True).returncode == 0
        module = next(filter(passes, sorted(program.glob("DBB_C*.src"))))
        names = [module.name, module.with_suffix(".dat").name]
        self.page.locator("#program").set_input_files([program / name for name in names])
        expect(self.step("correct").locator("[data-action=next]")).to_contain_text(self.text("act.correct"), timeout=10_000)
        self.next("correct")
        self.state("correct", "done")
        expect(self.page.locator("#shift-rows tr").nth(10)).to_be_attached(timeout=10_000)
        corrected = {file.name for file in (cell / "demo" / "corrected").iterdir()}
        assert corrected >= {name for name in names if name.endswith(".src")}, corrected
        with self.page.expect_download() as downloaded:
            self.page.locator("#download").click()
        downloaded.value.save_as(self.out / "corrected.zip")
        self.look("correct")

    def check(self):
        self.page.locator("#tolerance").fill("5")
        check = self.step("check").locator("[data-action=next]")
        for keys in (["act.check_plan"], ["act.check_programs"], ["act.check_measure", "act.simulate", "act.start"]):
            labels = "|".join(re.escape(self.text(key)) for key in keys)
            expect(check).to_contain_text(re.compile(labels), timeout=120_000)
            check.click()
        # A run of the check leads to the check, and is no run of the calibration.
        self.halt("check")
        expect(check).to_have_text(self.texts["act.check"], timeout=180_000)
        self.state("result", "done")
        expect(self.step("programs")).to_have_attribute("data-state", "done")
        check.click()
        expect(self.step("check")).to_have_attribute("data-state", re.compile("done|attention"), timeout=120_000)
        verdict = self.step("check").locator("[data-verdict]").get_attribute("data-verdict")
        self.state("check", {"pass": "done", "fail": "attention", "undecided": "attention"}[verdict])

    def certificate(self, cell):
        self.next("certificate")
        self.state("certificate", "done")
        self.look("certificate")
        for step in ("robot", "plan", "programs", "result", "correct", "check", "certificate"):
            self.picture(step)
        self.disturb("result", "correct", "check", "certificate")
        self.unplug(cell, "result", "correct", "check", "certificate")

    def reports(self):
        """Every page that was made says its verdict first, is narrow enough for a phone, and axe is silent with all its parts open."""
        page = self.context.new_page()
        page.set_viewport_size({"width": 390, "height": 844})
        page.on("console", lambda m: self.complain(m.text))
        page.on("pageerror", lambda error: said.append(f"{self.form}: {error}"))
        for directory, file in (("plan", "plan"), ("result", "report"), ("check", "check"), ("certificate", "certificate")):
            step = "result" if file == "report" else file
            link = self.step(step).locator(f"a.button[href*='{directory}/{file}.html']")
            page.goto(self.url.rstrip("/") + link.get_attribute("href"))
            # What is signed has one language.
            if self.language == "de" and file != "certificate":
                assert page.evaluate("document.documentElement.lang").startswith("de"), file
                english = page.locator(f":is({OWN_WORDS}):is([lang=en], :has([lang=en]))")
                assert english.count() == 0, (file, english.first.inner_text())
            if file in ("report", "check"):
                # A result is judged where somebody stated a tolerance.
                verdicts = ("pass", "fail", "undecided") if file == "check" else ("pass", "fail", "undecided", "none")
                assert page.locator("[data-verdict]").get_attribute("data-verdict") in verdicts
                # A link of the contents opens its part.
                link = page.locator("nav.contents a").nth(1)
                part = page.locator("details.part").nth(1)
                expect(part).not_to_have_attribute("open", "")
                link.click()
                expect(part).to_have_attribute("open", "")
            page.evaluate("document.querySelectorAll('details').forEach((one) => (one.open = true))")
            page.screenshot(path=self.out / f"report-{file}.png", full_page=True)
            page.evaluate(AXE)
            for one in page.evaluate("(rules) => axe.run({ runOnly: rules })", RULES)["violations"]:
                print("axe", self.form, file, one["id"], [node["html"][:150] for node in one["nodes"]][:3])
                said.append(f"axe: {one['id']} in {file}.html")
            assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0, file
        page.close()


def same_as_the_command_line(cell):
    """The result of the page is that of the command which the page shows."""
    runs = sorted((cell / "dbbd-runs").glob("run-*/run.dbbd"), key=lambda path: path.stat().st_mtime)
    run = runs[0]
    subprocess.run([DBBD, "--quiet", "identify", run, "--out", cell / "again"], stdout=subprocess.DEVNULL, timeout=120)
    one, other = (json.loads((cell / at / "result.json").read_text()) for at in ("demo/result", "again"))
    assert one["parameters"] == other["parameters"]
    names = [{file.name for file in (cell / at).iterdir() if file.is_file()} for at in ("demo/result", "again")]
    # What a step of the page has to say is kept for whoever opens it later.
    assert names[0] - {"findings.json"} == names[1], names
    shutil.rmtree(cell / "again")


def play(browser, form):
    out = OUT / form
    cell = out / "cell"
    shutil.rmtree(out, ignore_errors=True)
    cell.mkdir(parents=True)
    configure(cell, form.endswith("-token"))
    service, url = serve(DBBD, cell)
    try:
        story = Story(browser, service, url, form, out)
        story.sign_in()
        story.make_a_robot(cell)
        story.demo()
        story.leave_out(cell)
        story.scene()
        story.correct(cell)
        story.check()
        story.certificate(cell)
        story.reports()
        story.context.close()
        same_as_the_command_line(cell)
    finally:
        service.terminate()
        service.wait()


def renew_pictures(form):
    for file in sorted((OUT / form).glob("step-*.png")):
        picture = Image.open(file).convert("RGB")
        shown = picture.crop((0, 0, picture.width, min(picture.height, MAX_PICTURE)))
        target = ROOT / "docs/workbench" / f"{file.stem.removeprefix('step-')}.webp"
        target.parent.mkdir(exist_ok=True)
        shown.save(target, quality=70, method=6)
        print(f"{target}: {target.stat().st_size} bytes")


def main():
    pictures = sys.argv[3:] == ["--pictures"]
    forms = [PICTURED] if pictures else sys.argv[3:] or FORMS
    OUT.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright:
        graphics = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", *graphics])
        for form in forms:
            began = time.monotonic()
            play(browser, form)
            print(f"{form}: played in {time.monotonic() - began:.0f} s", flush=True)
        browser.close()
    print("console and axe:", said or "silent")
    assert not said
    if pictures:
        renew_pictures(PICTURED)


main()
