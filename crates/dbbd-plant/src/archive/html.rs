//! The pages of a plant: `dbbd archive serve`.

use serde::Serialize;

use dbbd_job::artefact::VERSION;
use dbbd_job::report::page::{Template, fill};
use dbbd_model::diagnostic::Diagnostic;

pub(crate) const STYLE: &str = concat!(
    include_str!("../../../dbbd-job/src/report/plot.css"),
    include_str!("../../../dbbd-job/src/report/page.css"),
    include_str!("html/plant.css")
);
/// The script of the page that asks for the token.
pub(crate) const SIGN_IN_JS: &str = include_str!("html/sign-in.js");

const SHARED: [Template<'_>; 2] = [
    ("plant.html", include_str!("html/plant.html")),
    ("plant_macros.html", include_str!("html/macros.html")),
];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PlantPage {
    Robots,
    Robot,
    Bars,
    Bar,
    Runs,
    Run,
    Refusal,
    SignIn,
}

impl PlantPage {
    fn template(self) -> Template<'static> {
        match self {
            Self::Robots => ("robots.html", include_str!("html/robots.html")),
            Self::Robot => ("robot.html", include_str!("html/robot.html")),
            Self::Bars => ("bars.html", include_str!("html/bars.html")),
            Self::Bar => ("bar.html", include_str!("html/bar.html")),
            Self::Runs => ("runs.html", include_str!("html/runs.html")),
            Self::Run => ("run.html", include_str!("html/run.html")),
            Self::Refusal => ("refusal.html", include_str!("html/refusal.html")),
            Self::SignIn => ("sign-in.html", include_str!("html/sign-in.html")),
        }
    }

    pub(crate) fn html(self, page: &impl Serialize) -> Result<String, Diagnostic> {
        #[derive(Serialize)]
        struct Context<'a, T> {
            version: &'static str,
            page: &'a T,
        }
        let [shared, macros] = SHARED;
        fill(&[shared, macros, self.template()], &Context { version: VERSION, page })
    }
}
