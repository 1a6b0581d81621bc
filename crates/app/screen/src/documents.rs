//! Pages of the documentation for machines without a network; alarms and events of the page link to them.

use std::collections::HashMap;

use axum::extract::Path as UrlPath;
use axum::http::StatusCode;
use axum::response::{Html, IntoResponse, Response};
use pulldown_cmark::{CowStr, Event, HeadingLevel, Options, Parser, Tag, TagEnd, html};

use crate::gate::Framed;

macro_rules! pages {
    ($($name:literal),* $(,)?) => {
        /// Name and text, as Markdown.
        const PAGES: &[(&str, &str)] = &[$(($name, include_str!(concat!("../../../../docs/", $name, ".md")))),*];
    };
}

// The pages for operators and for setting up a machine.
pages!(
    "alarms",
    "faq",
    "errors",
    "screen",
    "leaving-a-program",
    "homing",
    "handwheel",
    "probing",
    "tool-change",
    "threading",
    "SPECNOTES",
    "contract",
    "bridges",
    "host",
);

const STYLE: &str = "body{font:16px/1.5 system-ui,sans-serif;max-width:46rem;margin:0 auto;padding:0 1rem 50vh}:target{scroll-margin-top:.5rem;background:#fdeeca}a{color:#075a9c}h1{font-size:1.5rem}h2{font-size:1.15rem}h3{font-size:1rem}code{font-size:.9em}pre{overflow:auto}pre,tr:nth-child(even){background:#0001}pre{padding:.5rem}table{border-collapse:collapse;display:block;overflow:auto}td,th{border:1px solid #8886;padding:.2rem .5rem;text-align:left}";
const DARK: &str = "body{background:#12181f;color:#e8edf2}a{color:#7cc0ff}:target{background:#4a3500}\
     pre,tr:nth-child(even){background:#fff1}";

/// A page; `theme` is `light` or `dark`.
pub(crate) async fn document(UrlPath((_key, theme, file)): UrlPath<(String, String, String)>) -> Response {
    let name = file.strip_suffix(".html").unwrap_or_default();
    match text_of(name) {
        Some(text) => {
            let mut response = Html(page(text, theme == "dark")).into_response();
            response.extensions_mut().insert(Framed);
            response
        }
        None => StatusCode::NOT_FOUND.into_response(),
    }
}

fn text_of(name: &str) -> Option<&'static str> {
    PAGES
        .iter()
        .find(|(known, _)| *known == name)
        .map(|&(_, text)| text)
}

fn page(text: &str, is_dark: bool) -> String {
    let events: Vec<Event<'_>> = Parser::new_ext(text, Options::ENABLE_TABLES).collect();
    let ids = ids_of(&events);
    let mut ids = ids.into_iter();
    // Links to other pages are shown as text. Pictures are not part of the binary.
    let (mut linked, mut pictures) = (Vec::new(), 0_u32);
    let shown = events.into_iter().filter_map(|event| match event {
        Event::Start(Tag::Heading {
            level,
            classes,
            attrs,
            ..
        }) => Some(Event::Start(Tag::Heading {
            level,
            id: ids.next().map(CowStr::from),
            classes,
            attrs,
        })),
        Event::Start(Tag::Link {
            link_type,
            dest_url,
            title,
            id,
        }) => {
            let target = target_of(&dest_url);
            linked.push(target.is_some());
            target.map(|target| {
                Event::Start(Tag::Link {
                    link_type,
                    dest_url: target.into(),
                    title,
                    id,
                })
            })
        }
        Event::End(TagEnd::Link) => linked.pop().unwrap_or(false).then_some(event),
        Event::Start(Tag::Image { .. }) => {
            pictures += 1;
            None
        }
        Event::End(TagEnd::Image) => {
            pictures = pictures.saturating_sub(1);
            None
        }
        _ if pictures > 0 => None,
        Event::Html(_) | Event::InlineHtml(_) => None,
        other => Some(other),
    });
    let mut body = String::new();
    html::push_html(&mut body, shown);
    let dark = if is_dark { DARK } else { "" };
    format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" \
         content=\"width=device-width\"><title>Evolvent</title><style>{STYLE}{dark}</style><body>{body}"
    )
}

/// The anchor of every heading, as the book and GitHub generate it.
fn ids_of(events: &[Event<'_>]) -> Vec<String> {
    let (mut ids, mut open, mut seen) = (Vec::new(), None::<(HeadingLevel, String)>, HashMap::new());
    for event in events {
        match event {
            Event::Start(Tag::Heading { level, .. }) => open = Some((*level, String::new())),
            Event::Text(text) | Event::Code(text) => {
                if let Some((_, title)) = &mut open {
                    title.push_str(text);
                }
            }
            Event::End(TagEnd::Heading(_)) => {
                let Some((_, title)) = open.take() else { continue };
                let id = anchor(&title);
                let count = seen
                    .entry(id.clone())
                    .and_modify(|count| *count += 1)
                    .or_insert(0);
                ids.push(if *count == 0 { id } else { format!("{id}-{count}") });
            }
            _ => {}
        }
    }
    ids
}

fn anchor(title: &str) -> String {
    let kept = title.chars().filter_map(|letter| match letter {
        ' ' => Some('-'),
        '-' | '_' => Some(letter),
        _ if letter.is_alphanumeric() => Some(letter.to_ascii_lowercase()),
        _ => None,
    });
    kept.collect()
}

/// The target here of a Markdown link, if its page is one of these.
fn target_of(link: &str) -> Option<String> {
    let (page, anchor) = link
        .split_once('#')
        .map_or((link, None), |(page, anchor)| (page, Some(anchor)));
    let page = match page {
        "" => String::new(),
        _ => {
            let name = page.strip_suffix(".md")?;
            text_of(name)?;
            format!("{name}.html")
        }
    };
    Some(match anchor {
        Some(anchor) => format!("{page}#{anchor}"),
        None => page,
    })
}

#[cfg(test)]
mod tests {
    use evolvent_control::Alarm;

    use super::*;

    #[test]
    fn every_alarm_has_its_anchor_and_no_other_number_has() {
        let shown = page(text_of("alarms").unwrap(), false);
        let found: Vec<u32> = shown
            .match_indices("<h2 id=\"")
            .map(|(at, start)| {
                let rest = &shown[at + start.len()..];
                rest[..rest.find('"').unwrap()].parse().unwrap()
            })
            .collect();
        let known: Vec<u32> = Alarm::ALL.iter().map(|alarm| alarm.number()).collect();
        assert_eq!(found, known, "docs/alarms.md");
    }

    #[test]
    fn links_between_pages_lead_to_headings() {
        let shown: Vec<(&str, String)> = PAGES
            .iter()
            .map(|&(name, text)| (name, page(text, true)))
            .collect();
        let mut count = 0;
        for (from, text) in &shown {
            for (at, start) in text.match_indices("<a href=\"") {
                let rest = &text[at + start.len()..];
                let link = &rest[..rest.find('"').unwrap()];
                let (page, anchor) = link.split_once('#').unwrap_or((link, ""));
                let name = if page.is_empty() {
                    from
                } else {
                    page.strip_suffix(".html").unwrap()
                };
                let (_, target) = shown.iter().find(|(known, _)| *known == name).unwrap();
                let is_there = anchor.is_empty() || target.contains(&format!(" id=\"{anchor}\""));
                assert!(is_there, "{from}: {link}");
                count += 1;
            }
        }
        assert!(count > 50, "{count} links");
    }

    #[test]
    fn pages_hold_no_script_and_lead_nowhere_else() {
        let shown = page(
            "# A & <script>\n<script>x</script>\n\
             [out](https://example.org) [up](../README.md) ![p](a.png)\n\n# A & <script>\n",
            false,
        );
        let body = &shown[shown.find("<body>").unwrap()..];
        assert!(
            !body.contains("<script") && !body.contains("href") && !body.contains("src="),
            "{body}"
        );
        assert!(
            body.contains("<h1 id=\"a--\">") && body.contains("<h1 id=\"a---1\">"),
            "{body}"
        );
    }
}
