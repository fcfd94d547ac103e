"""Drives the page in headless Chromium as an operator would: from opening it with no run to the report.

    pip install playwright axe-playwright-python
    python tests/clients/page.py target/release/dbbd OUT [LANGUAGE ..]

Plans a small circle, serves, and plays the story for each of desktop and phone, light and dark, English and German.
Screenshots go to OUT. Ends with an error when something is missing, cut off on the phone, when the console is not silent
or axe finds a violation.
"""

import json
import pathlib
import re
import shutil
import signal
import subprocess
import sys
import urllib.request

from browser import AXE, CHROMIUM, expect, serve, sync_playwright

DBBD, OUT = pathlib.Path(sys.argv[1]).resolve(), pathlib.Path(sys.argv[2]).resolve()
ROOT = pathlib.Path(__file__).parents[2]
TEXTS = {file.stem: json.loads(file.read_text()) for file in (ROOT / "src/live/page/texts").glob("*.json")}
# Every view that axe looked at, and what the console, the pages and axe complained about.
looked, said = [], []

SIZES = {"desktop": {"width": 1400, "height": 1000}, "phone": {"width": 390, "height": 844}}
STORIES = [("desktop", "en", "light"), ("phone", "de", "dark"), ("desktop", "de", "dark"), ("phone", "en", "light")]


def prepare(cell):
    shutil.rmtree(cell, ignore_errors=True)
    cell.mkdir(parents=True)
    job = (ROOT / "examples/circles.toml").read_text().replace("points = 80", "points = 24")
    (cell / "job.toml").write_text(job)
    (cell / "dbbd.toml").write_text('address = "127.0.0.1:0"\n[device]\nport = "bar"\n')
    for step in (["plan", "job.toml", "--out", "plan"], ["krl", "plan/plan.csv", "--out", "krl"]):
        subprocess.run([DBBD, "--quiet", *step], cwd=cell, timeout=300, stdout=subprocess.DEVNULL)


def simulate(cell, *more):
    # Every run needs a cell of its own: the program ends with it.
    args = [DBBD, "simulate", "--program", "krl/DBB_MAIN.src", "--tool", "30,20,10", "--link", "bar", "--quiet", *more]
    return subprocess.Popen(args, cwd=cell, stdout=subprocess.DEVNULL)


class Story:
    """One operator with a browser of a size, a language and a scheme."""

    def __init__(self, browser, url, size, language, scheme):
        self.name = f"{size}-{language}-{scheme}"
        self.texts, self.size = TEXTS[language], size
        locale = {"en": "en-GB", "de": "de-DE"}[language]
        self.context = browser.new_context(
            viewport=SIZES[size], locale=locale, color_scheme=scheme, has_touch=size == "phone",
            device_scale_factor=2 if size == "phone" else 1)
        self.page = self.context.new_page()
        self.cut = False
        self.page.on("console", lambda m: self.complain(m.text))
        self.page.on("pageerror", lambda error: self.complain(str(error)))
        self.page.goto(url + "live")
        expect(self.page.locator("html")).to_have_attribute("lang", language)

    def complain(self, text):
        if not self.cut:
            said.append(f"{self.name}: {text}")

    def at(self, id):
        return self.page.locator("#" + id)

    def button(self, key):
        return self.page.get_by_role("button", name=self.texts[key], exact=True)

    def look(self, what):
        """A screenshot, what axe says, and whether something is cut off."""
        self.page.screenshot(path=OUT / f"{self.name}-{what}.png", full_page=True)
        self.page.evaluate(AXE)
        found = self.page.evaluate("() => axe.run()")
        for one in found["violations"]:
            print("axe", self.name, what, one["id"], [node["html"][:150] for node in one["nodes"]][:3])
            said.append(f"axe: {one['id']}")
        looked.append(len(found["passes"]))
        cut = self.page.evaluate("""() => [...document.querySelectorAll("body *")]
            .filter((e) => e.checkVisibility() && !e.closest("svg, .skip, thead") && getComputedStyle(e).position !== "absolute")
            .filter((e) => e.getBoundingClientRect().right > innerWidth + 0.5)
            .filter((e) => !e.closest(".scroll") || innerWidth < 520).map((e) => e.outerHTML.slice(0, 120))""")
        wide = self.page.evaluate("document.documentElement.scrollWidth - innerWidth")
        assert not cut and wide <= 0, f"{self.name}, {what}: cut off ({wide}): {cut}"

    def connect(self):
        expect(self.at("state")).to_have_text(self.texts["state.idle"], timeout=20_000)
        expect(self.at("plan")).to_have_value("plan")
        expect(self.at("plan-for")).to_contain_text("KUKA KR 60")
        expect(self.at("start")).to_be_disabled()
        self.look("1-open")
        self.button("connect").click()
        expect(self.at("state")).to_have_text(self.texts["state.reading"], timeout=20_000)
        expect(self.at("steady")).to_have_text(self.texts["steady.stable"], timeout=60_000)
        expect(self.at("steady-detail")).to_contain_text("µm/s")
        expect(self.at("low")).to_contain_text("mm")
        self.look("2-reading")
        # This protocol has no command for it.
        expect(self.at("zero")).to_be_hidden()

    def start(self, run):
        self.at("name").fill(run)
        for box in self.page.locator("#checks input").all():
            expect(self.at("start")).to_be_disabled()
            box.check()
        self.look("3-checked")
        self.button("start").click()
        expect(self.at("state")).to_have_text(self.texts["state.running"], timeout=20_000)

    def run(self):
        points = self.page.locator("#plot circle:not(.ring):not(.nominal), #plot rect")
        expect(points.nth(3)).to_be_attached(timeout=90_000)
        expect(self.at("time-left")).to_contain_text("min")
        expect(self.at("next")).to_contain_text("°")
        expect(self.at("run-plan")).to_contain_text("KUKA KR 60")
        self.at("remark").fill("a remark from the page")
        self.button("remark.write").click()
        expect(self.at("message")).to_have_text(self.texts["remark.written"])
        self.at("sound").uncheck()
        self.look("4-running")

    def disconnect_and_return(self, service):
        # The connection breaks, without a word and without an end, and comes back; the run goes on.
        self.cut = True
        service.send_signal(signal.SIGSTOP)
        expect(self.at("link")).to_have_text(self.texts["link.down"], timeout=15_000)
        service.send_signal(signal.SIGCONT)
        expect(self.at("link")).to_have_text("", timeout=20_000)
        self.cut = False
        expect(self.at("state")).to_have_text(self.texts["state.running"])

    def stop(self):
        self.button("stop").click()
        expect(self.button("stop.yes")).to_be_visible()
        self.look("5-stop")
        self.button("stop.no").click()
        expect(self.at("state")).to_have_text(self.texts["state.running"])
        self.button("stop").click()
        self.button("stop.yes").click()
        expect(self.at("last")).to_contain_text(self.texts["ending.stopped"], timeout=20_000)

    def evaluate(self, run):
        row = self.page.locator("#runs tr", has_text=run)
        row.get_by_role("button", name=self.texts["kind.identify"]).click()
        done = re.compile("|".join(re.escape(self.texts[key]) for key in ("job.done", "job.warned")))
        expect(self.at("jobs").locator("li", has_text=run).first).to_contain_text(done, timeout=180_000)
        report = row.get_by_role("link", name="report.html")
        expect(report).to_be_visible(timeout=10_000)
        self.look("6-results")
        with self.context.expect_page() as opened:
            report.click()
        opened.value.wait_for_load_state()
        assert "KUKA KR 60" in opened.value.content() and opened.value.locator("svg").count() > 0
        opened.value.screenshot(path=OUT / f"{self.name}-7-report.png")


def of_the_operator(url, run):
    """What the capture says that the operator did."""
    capture = OUT / "cell" / f"{run}.dbbd"
    with urllib.request.urlopen(f"{url}api/v1/runs/{run}/capture") as answer:
        capture.write_bytes(answer.read())
    info = json.loads(subprocess.run([DBBD, "info", capture, "--json"], capture_output=True, text=True).stdout)
    return [remark.split()[1] for remark in info["remarks"] if remark.startswith("operator: ")]


def play(browser, cell, service, url, story):
    robot = simulate(cell, "--halt", "60", "--speed", "2")
    try:
        run = "-".join(story)
        one = Story(browser, url, *story)
        one.connect()
        one.start(run)
        one.run()
        one.disconnect_and_return(service)
        one.stop()
        one.evaluate(run)
        acts = of_the_operator(url, run)
        for act in ("connect", "checked", "start", "sound_off", "stop"):
            assert act in acts, f"{run}: {act} is not in the capture: {acts}"
        one.button("disconnect").click()
        expect(one.at("state")).to_have_text(one.texts["state.idle"], timeout=20_000)
    finally:
        robot.terminate()
        robot.wait()
    one.cut = True
    expect(one.at("state")).to_contain_text(one.texts["state.no_device"], timeout=20_000)
    one.context.close()


def badly_mounted(browser, cell, url):
    """A bar that rocks is named on the page before any run, and the reading leaves with its port."""
    robot = simulate(cell, "--halt", "60", "--fault", "unseated_um=60")
    try:
        one = Story(browser, url, "phone", "de", "light")
        one.button("connect").click()
        expect(one.at("mounting")).to_contain_text("W0280", timeout=60_000)
        one.look("8-not-seated")
        one.button("mounting.clear").click()
        one.button("disconnect").click()
        expect(one.at("state")).to_have_text(one.texts["state.idle"], timeout=20_000)
    finally:
        robot.terminate()
        robot.wait()


def main():
    OUT.mkdir(parents=True, exist_ok=True)
    cell = OUT / "cell"
    prepare(cell)
    stories = [story for story in STORIES if len(sys.argv) < 4 or story[1] in sys.argv[3:]]
    service, url = serve(DBBD, cell)
    try:
        with sync_playwright() as playwright:
            # The policy of the page forbids scripts of others; axe is evaluated from outside.
            browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
            for story in stories:
                play(browser, cell, service, url, story)
                print("played", *story)
            badly_mounted(browser, cell, url)
            browser.close()
    finally:
        service.terminate()
        service.wait()
    print(f"axe: {len(looked)} views, {min(looked)} to {max(looked)} rules passed in each")
    print("console and axe:", said or "silent")
    assert not said


main()
