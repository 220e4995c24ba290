"""The page as a Vue template; `workbench.app.server` keeps its state.

The spectrum is lines of SVG, and so are axes and marks over the pictures of fields: letters stay sharp, and a new
spectrum is ten kilobytes. Everything is served by the page's own server.
"""

from __future__ import annotations

from typing import Any

from workbench.app import plot

_STYLE = """
html { overflow-y: auto !important; }
.live { display: grid; grid-template: 36px 1fr / 340px minmax(0, 1fr); gap: 6px 10px; padding: 8px 12px;
        background: #f4f6f8; min-height: 100vh; font-family: Roboto, sans-serif; color: #1c2733; }
.live .bar { grid-column: 1 / 3; display: flex; align-items: center; gap: 8px; height: 36px; }
.live .bar h1 { font-size: 17px; font-weight: 600; margin: 0 8px 0 0; white-space: nowrap; }
.live .bar .state { color: #5a6b7b; margin-right: auto; font-size: 13px; white-space: nowrap; overflow: hidden;
        text-overflow: ellipsis; }
.live .card { background: white; border: 1px solid #dfe5ea; border-radius: 8px; }
.live .left { display: flex; flex-direction: column; gap: 6px; align-self: start; max-height: calc(100vh - 60px); }
.live .side { padding: 6px 10px; overflow-y: auto; }
.live .heads { display: flex; font-size: 11px; color: #5a6b7b; padding: 2px 0 4px; }
.live .row { border-top: 1px solid #eef1f4; padding: 4px 0 0; }
.live .row .names { display: flex; align-items: baseline; gap: 4px; font-size: 12.5px; }
.live .row .names .what { flex: 1; white-space: nowrap; overflow: hidden; text-overflow: ellipsis; }
.live .row .names .what.out { color: #c0392b; font-weight: 600; }
.live input.number { width: 78px; text-align: right; border: 1px solid #cfd8e0; border-radius: 4px; padding: 0 4px;
        font-size: 12.5px; background: white; }
.live input.tolerance { width: 48px; }
.live input.tolerance.assumed { font-style: italic; color: #7a6a1f; background: #fdf8e4; }
.live .unit { width: 34px; color: #5a6b7b; font-size: 11.5px; }
.live .row .v-slider { margin: 0 2px; }
.live .row .tools { display: flex; align-items: center; }
.live .row .tools .v-slider { flex: 1; }
.live .row .tools input[type=checkbox] { margin: 0 2px 0 8px; }
.live .reset { cursor: pointer; color: #5a6b7b; font-size: 14px; padding: 0 2px; border: none; background: none; }
.live .figures { display: flex; gap: 8px; margin-bottom: 6px; }
.live .figures .card { flex: 1; padding: 2px 10px; min-width: 0; line-height: 1.25; }
.live .figures .name { font-size: 11px; color: #5a6b7b; white-space: nowrap; overflow: hidden;
        text-overflow: ellipsis; }
.live .figures .value { font-size: 17px; font-weight: 600; white-space: nowrap; }
.live .figures .note { font-size: 11px; color: #5a6b7b; white-space: nowrap; overflow: hidden; text-overflow: ellipsis;
        min-height: 14px; }
.live svg text { font-size: 11px; fill: #43525f; }
.live .fields { display: grid; grid-template-columns: 1fr 1fr; gap: 6px; margin-top: 6px; }
.live .fields .wide { grid-column: 1 / 3; }
.live .fields .card { padding: 4px 8px; }
.live .fields .at { display: flex; align-items: center; font-size: 12px; gap: 8px; padding: 0 8px; height: 26px; }
.live .title { font-size: 12px; display: flex; gap: 8px; align-items: center; }
.live .title .words { flex: 1; color: #43525f; }
.live .legend { display: inline-block; width: 90px; height: 9px; border: 1px solid #cfd8e0; }
.live .row .v-slider.v-input--horizontal { min-height: 24px; }
.live .legends { white-space: nowrap; font-size: 11px; color: #43525f; }
.live .works { font-size: 11.5px; color: #43525f; padding: 4px 10px; line-height: 1.35;
        min-height: 80px; overflow-y: auto; flex-shrink: 1; }
.live .works > div { margin-bottom: 3px; }
.live .v-btn { text-transform: none; letter-spacing: 0; }
.live .works .kind { font-weight: 600; }
.live .works a { color: #1565c0; }
.live .error { color: #c0392b; }
@media (max-width: 1199px) {
  .live { grid-template: auto / minmax(0, 1fr); align-content: start; }
  .live .bar { grid-column: 1; flex-wrap: wrap; height: auto; }
  .live .left { max-height: none; align-self: stretch; }
  .live .figures { flex-wrap: wrap; }
  .live .figures .card { flex: 1 0 150px; }
}
@media (max-width: 799px) {
  .live .fields { grid-template-columns: minmax(0, 1fr); }
  .live .fields .wide { grid-column: 1; }
  .live #fields_at, .live .title { flex-wrap: wrap; white-space: normal !important; }
  .live .fields .at { height: auto; flex-wrap: wrap; }
  .live #spectrum text { font-size: 20px; }
}
.live .key { display: inline-block; width: 18px; height: 0; border-top: 2.5px solid; vertical-align: middle;
        margin: 0 4px 0 10px; }
"""

_BAR = """
<div class="bar">
  <h1>{{ heading }}</h1><span class="state">{{ subheading }}</span>
  <v-btn size="small" variant="text" icon="mdi-undo" id="undo" title="undo" :disabled="!can_undo"
         @click="trigger('undo')"></v-btn>
  <v-btn size="small" variant="text" icon="mdi-redo" id="redo" title="redo" :disabled="!can_redo"
         @click="trigger('redo')"></v-btn>
  <v-btn size="small" variant="text" id="reset" @click="trigger('reset', [''])">Reset</v-btn>
  <v-btn size="small" variant="tonal" id="full" @click="trigger('full')">
    {{ works.full && works.full.running ? 'Stop solving' : 'Full solve' }}</v-btn>
  <v-btn size="small" variant="tonal" id="fit" v-if="has_recording" @click="trigger('fit')"
         title="fit the numbers that are ticked to the recording">
    {{ works.fit && works.fit.running ? 'Stop fitting' : 'Fit what I have freed' }}</v-btn>
  <v-btn size="small" variant="tonal" id="diagnose" v-if="can_diagnose" @click="trigger('diagnose')">
    {{ works.diagnose && works.diagnose.running ? 'Stop diagnosing' : 'Diagnose' }}</v-btn>
  <input class="number" style="width: 170px; height: 28px; text-align: left" id="file" v-model="file"
         title="name of the chip file" />
  <v-btn size="small" color="primary" id="save" @click="trigger('save', [file])">Save as chip file</v-btn>
</div>
"""

_HEADS = """
<div class="heads"><span style="flex: 1">fit &nbsp; number</span><span style="width: 60px">value</span>
  <span style="width: 70px; text-align: right">± tolerance</span></div>
<div class="heads" v-if="rows.some(each => each.assumed)" id="assumed"><span><i>In italics</i>: stated nowhere,
  assumed by the role of the layer (point at it).</span></div>
"""

#: One parameter, at an index of ``rows``; its value is separate state, since the slider moves it. A field is replaced
#: when its value changes or a value was entered in its row, so that refused text disappears; while a user types, it is
#: not changed.
_ROW = """
<div class="row">
  <div class="names"><span class="what" :class="{out: rows[I].outside}" :title="rows[I].name">{{ rows[I].label }}</span>
    <input class="number" id="number_I" :key="'n' + x_I + '/' + rows[I].entries" :value.attr="x_I"
           @change="trigger('enter', [rows[I].name, $event.target.value])" />
    <span class="unit">{{ rows[I].unit }}</span>
    <input class="number tolerance" :class="{assumed: rows[I].assumed}" id="tolerance_I"
           :key="'t' + rows[I].tolerance + '/' + rows[I].entries" :value.attr="rows[I].tolerance"
           :title="rows[I].assumed ? 'assumed: ' + rows[I].assumed : 'stated; empty this field to go back'"
           @change="trigger('tolerate', [rows[I].name, $event.target.value])" />
  </div>
  <div class="tools">
    <input type="checkbox" id="free_I" :checked="rows[I].free" title="free in a fit"
           @change="trigger('free', [rows[I].name, $event.target.checked])" />
    <v-slider id="slider_I" v-model="x_I" :min="rows[I].low" :max="rows[I].high" :step="rows[I].step"
              density="compact" hide-details thumb-size="13" track-size="3" color="#1565c0"></v-slider>
    <button class="reset" id="reset_I" :title="'back to ' + rows[I].value"
            @click="trigger('reset', [rows[I].name])">↺</button>
  </div>
</div>
"""

_FIGURES = """
<div class="figures">
  <div class="card" v-for="each in figures" :key="each.name">
    <div class="name">{{ each.name }}</div><div class="value" :id="each.id">{{ each.value }}</div>
    <div class="note" :title="each.note">{{ each.note }}</div>
  </div>
</div>
"""

_SHARE = "($event.clientX - $event.currentTarget.getBoundingClientRect().left) / $event.currentTarget.clientWidth"

_SPECTRUM = f"""
<div class="card" style="padding: 4px 8px">
  <div class="title"><span class="words">
    <b>|Z| and phase</b> over frequency in MHz; click to see the fields there
    <span class="key" style="border-color: #1565c0"></span>model
    <template v-if="recorded.magnitude"><span class="key" style="border-color: #e07b00"></span>{{{{ recorded.name }}}}
    </template><template v-if="curve.tolerance"><span class="key" style="border-color: #bcd6f2; border-top-width: 8px">
    </span>one standard deviation by the tolerances</template>
    <template v-if="full_dots.length"><span class="key" style="border-color: #111; width: 6px; border-top-width: 6px">
    </span>full solves</template></span>
    <span id="pointed">{{{{ pointed }}}}</span></div>
  <svg id="spectrum" viewBox="0 0 {plot.WIDTH:g} {plot.HEIGHT:g}"
       style="width: 100%; display: block; cursor: crosshair"
       @mousemove="pointed = utils.live.readout($event, curve)" @mouseleave="pointed = ''"
       @click="trigger('pick', [{_SHARE}])">
    <g v-for="t in curve.ticks.x" :key="'x' + t.at">
      <line :x1="t.at" :x2="t.at" y1="{plot.MAGNITUDE[0]:g}" y2="{plot.PHASE[1]:g}" stroke="#e6ebf0"></line>
      <text :x="t.at" y="{plot.PHASE[1] + 14:g}" text-anchor="middle">{{{{ t.text }}}}</text></g>
    <g v-for="t in curve.ticks.y" :key="'y' + t.at">
      <line x1="{plot.LEFT:g}" x2="{plot.RIGHT:g}" :y1="t.at" :y2="t.at" stroke="#e6ebf0"></line>
      <text x="{plot.LEFT - 5:g}" :y="t.at + 4" text-anchor="end">{{{{ t.text }}}}</text></g>
    <g v-for="t in curve.ticks.phase" :key="'p' + t.at">
      <line x1="{plot.LEFT:g}" x2="{plot.RIGHT:g}" :y1="t.at" :y2="t.at" stroke="#e6ebf0"></line>
      <text x="{plot.LEFT - 5:g}" :y="t.at + 4" text-anchor="end">{{{{ t.text }}}}</text></g>
    <text x="12" y="{sum(plot.MAGNITUDE) / 2:g}" text-anchor="middle"
          transform="rotate(-90 12 {sum(plot.MAGNITUDE) / 2:g})">|Z| (ohm)</text>
    <text x="12" y="{sum(plot.PHASE) / 2:g}" text-anchor="middle"
          transform="rotate(-90 12 {sum(plot.PHASE) / 2:g})">phase</text>
    <clipPath id="panel"><rect x="{plot.LEFT:g}" y="{plot.MAGNITUDE[0]:g}" width="{plot.RIGHT - plot.LEFT:g}"
      height="{plot.MAGNITUDE[1] - plot.MAGNITUDE[0]:g}"></rect></clipPath>
    <path v-if="curve.tolerance" id="tolerance" clip-path="url(#panel)" :d="curve.tolerance" fill="#bcd6f2"
          fill-opacity="0.7"></path>
    <path v-if="recorded.magnitude" id="recorded" :d="recorded.magnitude" fill="none" stroke="#e07b00"
          stroke-width="1.4"></path>
    <path v-if="recorded.phase" :d="recorded.phase" fill="none" stroke="#e07b00" stroke-width="1.2"></path>
    <path id="magnitude" :d="curve.magnitude" fill="none" stroke="#1565c0" stroke-width="1.8"></path>
    <path :d="curve.phase" fill="none" stroke="#1565c0" stroke-width="1.4"></path>
    <g v-for="dot in full_dots" :key="'d' + dot.x"><circle :cx="dot.x" :cy="dot.y" r="2.3" fill="#111"></circle>
      <circle :cx="dot.x" :cy="dot.p" r="1.8" fill="#111"></circle></g>
    <line v-if="shown.x" id="shown" :x1="shown.x" :x2="shown.x" y1="{plot.MAGNITUDE[0]:g}" y2="{plot.PHASE[1]:g}"
          stroke="#c0392b" stroke-width="1.2" stroke-dasharray="4 3"></line>
    <text v-if="shown.x" :x="shown.x + (shown.x > 800 ? -5 : 5)" y="{plot.MAGNITUDE[0] + 12:g}"
          :text-anchor="shown.x > 800 ? 'end' : 'start'" style="fill: #c0392b">{{{{ shown.text }}}}</text>
  </svg>
</div>
"""

_FIELDS = """
<div class="fields">
  <div class="card wide at">
    <b>Fields</b><span id="fields_at" style="flex: 1; white-space: nowrap; overflow: hidden; text-overflow: ellipsis"
    :title="fields_at">{{ fields_at }}</span>
    <v-btn size="x-small" variant="text" id="follow" v-if="!shown.follows" @click="trigger('follow')">
      back to the operating point</v-btn>
    <v-btn size="x-small" :variant="in_space ? 'tonal' : 'text'" id="space" v-if="has_space"
           @click="trigger('space')">{{ in_space ? 'section' : 'in space' }}</v-btn></div>
  <div class="card wide" v-if="in_space && space"><img id="space_picture" :src="space" style="width: 100%" /></div>
  <template v-if="!in_space">
  <div class="card" v-for="each in pictures" :key="each.name" :class="{wide: each.wide}">
    <div class="title"><span class="words"><b>{{ each.title }}</b> {{ each.note }}</span>
      <span class="legends">{{ each.low }} <span class="legend" :style="{background: each.colours}"></span>
      {{ each.high }} {{ each.unit }}</span></div>
    <svg :id="'picture_' + each.name" :viewBox="'0 0 ' + each.width + ' ' + (each.height + each.strip)"
         style="display: block; width: 100%" :style="{maxHeight: each.tallest}">
      <image :href="each.png" x="0" y="0" :width="each.width" :height="each.height" preserveAspectRatio="none"></image>
      <path :d="each.outline" fill="none" stroke="#303030" stroke-width="0.4"></path>
      <g v-for="mark in each.marks" :key="mark.x + ',' + mark.y"><title>{{ mark.text }}</title>
        <path :d="'M' + (mark.x - 5) + ' ' + (mark.y - 5) + 'l10 10m-10 0l10 -10'" stroke="white"
              stroke-width="2"></path></g>
      <g v-for="t in each.ticks" :key="t.at"><line :x1="t.at" :x2="t.at" :y1="each.height"
         :y2="each.height + 0.2 * each.strip" stroke="#43525f"></line>
      <text class="tick" :x="t.at" :y="each.height + 0.8 * each.strip" :text-anchor="t.anchor"
            :style="{fontSize: each.letters + 'px'}">{{ t.text }}</text></g>
    </svg>
  </div></template>
</div>
"""

_WORKS = """
<div class="card works" id="works">
  <div v-if="message" id="message" :class="{error: message_is_error}">{{ message }}</div>
  <div v-for="(each, kind) in works" :key="kind"><span v-if="each.text"><span class="kind">{{ each.name }}</span>
    <v-progress-circular v-if="each.running" indeterminate size="11" width="2" style="margin: 0 4px">
    </v-progress-circular> {{ each.text }} <a v-if="each.report" :href="each.report" target="_blank">report</a></span>
  </div>
</div>
"""


def template(count: int) -> str:
    """The page with `count` adjustable parameters."""
    rows = "".join(_ROW.replace("[I]", f"[{i}]").replace("_I", f"_{i}") for i in range(count))
    return (f"<div class='live'>{_BAR}<div class='left'><div class='card side'>{_HEADS}{rows}</div>{_WORKS}</div>"
            f"<div>{_FIGURES}{_SPECTRUM}{_FIELDS}</div></div>")


#: Function that reads the spectrum at the frequency nearest to the mouse pointer.
_READOUT = f"""
window.trame.utils.live = {{
  readout(event, curve) {{
    const box = event.currentTarget.getBoundingClientRect();
    const x = (event.clientX - box.left) / box.width * {plot.WIDTH:g};
    const share = (x - {plot.LEFT:g}) / ({plot.RIGHT:g} - {plot.LEFT:g});
    const last = curve.read.frequency.length - 1;
    if (share < 0 || share > 1 || last < 0) return '';
    const k = Math.round(share * last);
    return `${{curve.read.frequency[k].toFixed(4)}} MHz: ${{curve.read.magnitude[k]}} ohm, ` +
           `${{curve.read.phase[k]}}°`;
  }},
}};
"""


def lay_out(server: Any, count: int) -> None:
    """Set the page of a trame server, with `count` adjustable parameters."""
    from trame.ui.vuetify3 import VAppLayout
    from trame.widgets import client, html

    with VAppLayout(server, vuetify_config={"theme": {"defaultTheme": "light"}}):
        client.Style(_STYLE)
        client.Script(_READOUT)
        html.Div(template(count))
