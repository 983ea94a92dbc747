
window.addEventListener("DOMContentLoaded", async () => {
  const page = document.documentElement;
  page.classList.add("scripted");
  try {
    let drawn = 0;
    for (const script of document.querySelectorAll("script.plot")) {
      await Bokeh.embed.embed_item(JSON.parse(script.textContent), script.dataset.at);
      page.dataset.drawn = ++drawn;
    }
  } catch (error) {
    page.classList.remove("scripted");
    throw error;
  }
});
