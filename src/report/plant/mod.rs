//! The pages of a plant: `dbbd archive serve`.

use serde::Serialize;

use super::page::{Template, fill};
use crate::diagnostic::Diagnostic;
use crate::provenance::VERSION;

pub const STYLE: &str =
    concat!(include_str!("../plot.css"), include_str!("../page.css"), include_str!("plant.css"));
/// The script of the page that asks for the token.
pub const SIGN_IN_JS: &str = include_str!("sign-in.js");

const SHARED: [Template<'_>; 2] =
    [("plant.html", include_str!("plant.html")), ("plant_macros.html", include_str!("macros.html"))];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlantPage {
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
            Self::Robots => ("robots.html", include_str!("robots.html")),
            Self::Robot => ("robot.html", include_str!("robot.html")),
            Self::Bars => ("bars.html", include_str!("bars.html")),
            Self::Bar => ("bar.html", include_str!("bar.html")),
            Self::Runs => ("runs.html", include_str!("runs.html")),
            Self::Run => ("run.html", include_str!("run.html")),
            Self::Refusal => ("refusal.html", include_str!("refusal.html")),
            Self::SignIn => ("sign-in.html", include_str!("sign-in.html")),
        }
    }

    pub fn html(self, page: &impl Serialize) -> Result<String, Diagnostic> {
        #[derive(Serialize)]
        struct Context<'a, T> {
            version: &'static str,
            page: &'a T,
        }
        let [shared, macros] = SHARED;
        fill(&[shared, macros, self.template()], &Context { version: VERSION, page })
    }
}
