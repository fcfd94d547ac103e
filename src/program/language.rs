//! The languages of robot controllers: how their files are recognised.

use crate::robot::{AXES, Robot};

/// A language in which programs are written, read and corrected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Language {
    // No doc comments: the help would list them. KUKA.
    Krl,
    // ABB.
    Rapid,
    // Universal Robots.
    Urscript,
}

impl Language {
    pub const ALL: [Self; 3] = [Self::Krl, Self::Rapid, Self::Urscript];

    /// As in robot files and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Krl => "krl",
            Self::Rapid => "rapid",
            Self::Urscript => "urscript",
        }
    }

    /// The language with this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|language| language.name() == name)
    }

    /// Of the files that hold programs, in small letters.
    fn extensions(self) -> &'static [&'static str] {
        match self {
            Self::Krl => &["src", "dat"],
            Self::Rapid => &["mod", "modx", "sys", "sysx", "prg"],
            Self::Urscript => &["script"],
        }
    }

    /// The language of a file with this extension.
    pub fn of_extension(extension: &str) -> Option<Self> {
        let known = |language: &Self| language.extensions().iter().any(|e| e.eq_ignore_ascii_case(extension));
        Self::ALL.into_iter().find(known)
    }

    /// The language of a program's text, by the line that begins its first routine or module.
    pub fn of_text(text: &str) -> Option<Self> {
        let first = |line: &str| Self::ALL.into_iter().find(|language| language.begins(line));
        text.split_inclusive('\n').find_map(first)
    }

    /// What begins a comment.
    pub fn comment(self) -> char {
        match self {
            Self::Krl => ';',
            Self::Rapid => '!',
            Self::Urscript => '#',
        }
    }

    /// Whether a whole line begins a routine, a data list or a module.
    pub(crate) fn begins(self, line: &str) -> bool {
        let mut words = line.split_ascii_whitespace();
        let first = words.next().unwrap_or("");
        let ends = line.ends_with('\n');
        match self {
            // `def` of URScript ends with a colon.
            Self::Krl => {
                let capital = |word: &str| word.to_ascii_uppercase();
                let word = if capital(first) == "GLOBAL" { words.next().unwrap_or("") } else { first };
                ends && ["DEF", "DEFFCT", "DEFDAT"].contains(&capital(word).as_str())
                    && !line.trim_end().ends_with(':')
            }
            Self::Rapid => ends && first.eq_ignore_ascii_case("MODULE"),
            Self::Urscript => ends && first == "def" && line.trim_end().ends_with(':'),
        }
    }

    /// Where a robot with such a controller is before a program: its home, degrees.
    pub(crate) fn home_deg(self) -> [f64; AXES] {
        match self {
            Self::Krl => [0.0, -90.0, 90.0, 0.0, 0.0, 0.0],
            Self::Rapid => [0.0; AXES],
            Self::Urscript => [0.0, -90.0, 0.0, -90.0, 0.0, 0.0],
        }
    }

    /// The language of a robot's controller; KRL where that is not known, as its simulated controller moves any robot.
    pub fn of_robot(robot: &Robot) -> Self {
        robot.controller_language().and_then(Self::named).unwrap_or(Self::Krl)
    }
}
