// Shares the moment that is shown: a link to it, and the code of a frame for other pages.

const FRAME = { width: 800, height: 640 };

export class Sharing {
  /** `menu` holds the fields; `moment` gives the env step that is shown. */
  constructor(menu, moment) {
    this.menu = menu;
    this.moment = moment;
    menu.addEventListener("toggle", () => menu.open && this.#fill());
    for (const button of menu.querySelectorAll("[data-copy]")) button.addEventListener("click", () => this.#copy(button.dataset.copy));
  }

  #fill() {
    const embed = this.menu.dataset.share;
    this.#field("link").value = this.#address(embed && window.location.pathname === embed ? embed.replace("/embed", "") : "");
    this.menu.querySelector("[role=status]").textContent = "";
    if (!embed) return;
    const frame = document.createElement("iframe");
    const title = document.querySelector(".player").dataset.heading;
    Object.assign(frame, { ...FRAME, title, loading: "lazy", src: this.#address(embed) });
    this.#field("frame").value = frame.outerHTML.replace("<iframe", '<iframe style="border: 0"'); // our pages allow no style
  }

  /** The address of a page of this site at the moment that is shown; of this page by default. */
  #address(path) {
    const address = new URL(path || window.location.href, window.location.href);
    address.searchParams.set("step", `${Number(this.moment().toFixed(2))}`);
    address.hash = "";
    return address.href;
  }

  #field(name) {
    return this.menu.closest("form").elements[name];
  }

  async #copy(name) {
    const field = this.#field(name);
    field.select();
    const isCopied = await copied(field.value);
    this.menu.querySelector("[role=status]").textContent = isCopied ? "Copied." : "The browser does not copy here: copy the marked text.";
  }
}

async function copied(text) {
  try {
    await navigator.clipboard.writeText(text); // needs a secure address
    return true;
  } catch {
    return document.execCommand("copy");
  }
}

/** The env step that the page's address asks for; undefined where it names none. */
export function askedStep() {
  const asked = new URLSearchParams(window.location.search).get("step");
  return asked === null ? undefined : Number(asked) || 0;
}
