// The parts of Chart.js that the pages draw with; what is not named here is not shipped.
import { Chart, LinearScale, LineElement, PointElement, ScatterController, Tooltip } from "chart.js";

Chart.register(LinearScale, LineElement, PointElement, ScatterController, Tooltip);
globalThis.Chart = Chart;
